"""The command of the extra "train" that writes models; it loads its libraries when called."""

from stillray.cli.program import run_extra


def export() -> None:
    """``stillray-export``"""
    run_extra("stillray_export.to_onnx", "main", "train")
