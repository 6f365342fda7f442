"""What else a user could run: Open Image Denoise, SVGF, BMFR and NFOR."""

from stillray_training.peers.oidn import OIDN_QUALITIES, open_image_denoise
from stillray_training.peers.registry import PEERS, Peer, PeerDenoiser, find_peer

__all__ = [
    "OIDN_QUALITIES",
    "PEERS",
    "Peer",
    "PeerDenoiser",
    "find_peer",
    "open_image_denoise",
]
