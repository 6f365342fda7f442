"""The version of the interface that is offered, for callers who look."""

from __future__ import annotations

#: Open Image Denoise's version whose interface this is.
oidn_version = "2.5.0"
