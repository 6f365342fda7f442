"""What denoising costs here: stages, memory, rooflines and scaling, on frames that are made up."""
