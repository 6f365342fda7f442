"""Flags as users of oidnDenoise write them, where they mean the same here."""

from __future__ import annotations

from collections.abc import Sequence

#: What oidnDenoise calls its qualities, and what they are here.
QUALITIES = {
    "f": "fast", "fast": "fast", "b": "balanced", "balanced": "balanced",
    "h": "high", "high": "high", "default": "high",
}  # fmt: skip


def spell_out(arguments: Sequence[str]) -> list[str]:
    """Arguments of ``stillray`` with ``-q`` made plain.

    ``-q high`` is oidnDenoise's quality; ``-q`` before anything else is quiet, as in most
    programs.
    """
    spelled: list[str] = []
    rest = iter(arguments)
    for argument in rest:
        if argument == "--":
            return [*spelled, argument, *rest]
        if argument != "-q" or spelled[:1] != ["denoise"]:
            spelled.append(argument)
            continue
        following = next(rest, None)
        if following in QUALITIES:
            spelled += ["--model", QUALITIES[following]]
        else:
            spelled.append("--quiet")
            if following is not None:
                spelled += spell_out(["denoise", following, *rest])[1:]
    return spelled
