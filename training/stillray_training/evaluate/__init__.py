"""Quality on frames with references: sequences, stills of any number of samples, fed references."""
