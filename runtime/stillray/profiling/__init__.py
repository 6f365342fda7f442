"""What denoising costs here: stages, memory, floors and scaling, on frames that are made up."""
