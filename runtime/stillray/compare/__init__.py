"""Comparing images: metrics against a reference, and a page that shows them side by side."""

#: Millions of pixels that a page carries unless told otherwise, all images and frames together.
#: Renders take 4 to 5 MB a million, so such a page has 100 to 125 MB.
MAX_MEGAPIXELS = 25.0
