"""The model that learns while it denoises: its graphs, its evaluation."""
