"""The peers by name: what else a user could run on the same frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Protocol

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame
from stillray_training.peers.oidn import (
    OIDN_QUALITIES,
    OpenImageDenoise,
    PrefilteredOpenImageDenoise,
)


class PeerDenoiser(Protocol):
    """One stream of frames through a peer; holds what it remembers of them."""

    def denoise(self, frame: Frame) -> np.ndarray:
        """Denoise the next frame: radiance ``(h, w, 3)`` float32."""


@dataclass(frozen=True, kw_only=True)
class Peer:
    """A denoiser to compare with."""

    name: str  # as ``--peer`` takes it
    label: str  # as tables show it
    remembers: bool  # whether earlier frames change its result
    module: str  # what has to be importable
    package: str  # what to install for that
    make: Callable[[], PeerDenoiser]
    halves: bool = False  # whether it takes frames of two halves of their samples, `Frame.color_b`

    @property
    def is_installed(self) -> bool:
        """Whether the peer can run here."""
        return find_spec(self.module) is not None


def _svgf() -> PeerDenoiser:
    from stillray_training.peers.svgf import Svgf

    return Svgf()


def _svgf_alone() -> PeerDenoiser:
    from stillray_training.peers.svgf import Svgf, SvgfOptions

    return Svgf(SvgfOptions(antialias_share=1.0))


def _bmfr() -> PeerDenoiser:
    from stillray_training.peers.bmfr import Bmfr

    return Bmfr()


def _nfor() -> PeerDenoiser:
    from stillray_training.peers.nfor import Nfor

    return Nfor()


#: Every peer, in the order of the tables.
PEERS = (
    Peer(
        name="svgf", label="SVGF", remembers=True, module="cv2",
        package="opencv-python-headless", make=_svgf,
    ),
    # its filter alone, as weight-sharing kernels and bilateral grids are filters alone
    Peer(
        name="svgf-alone", label="SVGF without TAA", remembers=True, module="cv2",
        package="opencv-python-headless", make=_svgf_alone,
    ),
    Peer(
        name="bmfr", label="BMFR", remembers=True, module="scipy", package="scipy", make=_bmfr,
    ),
    Peer(
        name="nfor", label="NFOR", remembers=False, module="cv2",
        package="opencv-python-headless", make=_nfor, halves=True,
    ),
    *(
        Peer(
            name=f"oidn-{quality}", label=f"OIDN {quality}", remembers=False, module="pyoidn",
            package="pyoidn", make=partial(OpenImageDenoise, quality),
        )
        for quality in OIDN_QUALITIES
    ),
    # albedo and normals first, as Blender does
    Peer(
        name="oidn-prefiltered", label="OIDN high, prefiltered", remembers=False, module="pyoidn",
        package="pyoidn", make=partial(PrefilteredOpenImageDenoise, "high"),
    ),
)  # fmt: skip


def find_peer(name: str) -> Peer:
    """A peer that can run here, by name.

    Raises
    ------
    InputError
        There is no such peer, or its package is not installed.
    """
    for peer in PEERS:
        if peer.name == name:
            if not peer.is_installed:
                raise InputError(f"peer {name} needs the package {peer.package}: pip install it")
            return peer
    raise InputError(f"peer must be one of {', '.join(peer.name for peer in PEERS)}, got {name}")
