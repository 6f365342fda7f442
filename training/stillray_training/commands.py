"""The commands of the extra "train"; each loads its libraries when it is called."""

from stillray.cli.program import run_extra


def simulate() -> None:
    """``stillray-simulate``"""
    run_extra("stillray_training.simulate.__main__", "simulate", "train")


def gather() -> None:
    """``stillray-gather``"""
    run_extra("stillray_training.own_renders", "main", "train")


def train() -> None:
    """``stillray-train``"""
    run_extra("stillray_training.train", "main", "train")


def evaluate() -> None:
    """``stillray-evaluate``"""
    run_extra("stillray_training.evaluate.__main__", "main", "train,compare")
