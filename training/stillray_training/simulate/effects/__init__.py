"""The effects by name: a scene names those it calls for, and nothing else is simulated."""

from __future__ import annotations

from collections.abc import Iterable

from stillray.errors import InputError
from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.effects.depth_of_field import DepthOfField
from stillray_training.simulate.effects.environment import Environment
from stillray_training.simulate.effects.glossy import Glossy
from stillray_training.simulate.effects.medium import Medium
from stillray_training.simulate.effects.mirror_glass import MirrorGlass
from stillray_training.simulate.effects.motion_blur import MotionBlur
from stillray_training.simulate.effects.moving import MovingLight, MovingObject
from stillray_training.simulate.effects.relief import Relief
from stillray_training.simulate.effects.soft_shadow import SoftShadow
from stillray_training.simulate.effects.sun import SunLight
from stillray_training.simulate.effects.texture import Texture

# The order in which a plan asks them: lamps get their extent before screens get their pictures.
EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        SoftShadow(),
        Texture(),
        Glossy(),
        MirrorGlass(),
        Environment(),
        SunLight(),
        MovingLight(),
        MovingObject(),
        DepthOfField(),
        MotionBlur(),
        Medium(),
        Relief(),  # last: it goes around whatever material the others have made
    )
}


def check_names(names: Iterable[str]) -> tuple[str, ...]:
    """The names in the order of the registry, each once.

    Raises
    ------
    InputError
        A name is not an effect's.
    """
    asked = set(names)
    if unknown := sorted(asked - set(EFFECTS)):
        raise InputError(f"effects must be of {', '.join(EFFECTS)}, got {', '.join(unknown)}")
    return tuple(name for name in EFFECTS if name in asked)
