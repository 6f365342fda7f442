"""Training of models that denoise and upscale at once, over sequences."""
