"""The study as data: variants of one model, trained alike, and the comparisons they are made for.

All start from the specification of `BASE`, or of `MULTI_RESOLUTION`, and differ from it in what
their names say: features, accumulation, demodulation, loss, patches and steps are the same.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from stillray.model_spec import ModelSpec, load
from stillray.model_spec.loader import ImportanceNetwork, PyramidNetwork
from stillray_training.families import FAMILIES, Family
from stillray_training.networks.repvgg import without_branches
from stillray_training.peers import kernel_prediction, multi_resolution_prediction

BASE = "wskp-6"
MULTI_RESOLUTION = "wskp-mr"
OTHER_SEED = "wskp-6, other seed"
#: Scored on a single frame, too: accumulation off.
ONE_FRAME = (BASE, "wskp-3", "KP")
SIZES = (3, 5, 7, 9, 11, 13)  # pixels, of the six fused kernels
_WIDTH = 16  # channels between blocks
KERNEL_COUNTS = tuple(range(1, len(SIZES) + 1))
# Short, so that the whole study fits into an hour of one core; the rest is the base's recipe.
_STEPS, _BATCH, _PATCH = 600, 4, 64
#: By the family of the model that a peer stands beside.
_PREDICTIONS = {
    "weight-sharing-kernels": kernel_prediction.FAMILY,
    "multi-resolution-kernels": multi_resolution_prediction.FAMILY,
}


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One model of the study.

    Attributes
    ----------
    spec
        What it is; its name is the variant's.
    predicts
        Whether every pixel's kernel is predicted, not made from an importance map: then the spec,
        that of the model which the peer stands beside, has one kernel size.
    """

    spec: ModelSpec
    predicts: bool = False

    @property
    def name(self) -> str:
        """The name in tables."""
        return self.spec.name

    @property
    def family(self) -> Family:
        """Network and reconstruction for training."""
        return (_PREDICTIONS if self.predicts else FAMILIES)[self.spec.family]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One table of the page.

    Attributes
    ----------
    title
        Its heading.
    source
        What of the paper it repeats.
    variants
        Names, in the order of the rows.
    """

    title: str
    source: str
    variants: tuple[str, ...]


def single(size: int) -> str:
    """The name of the variant with one kernel."""
    return f"one {size}x{size} kernel"


def fused(count: int) -> str:
    """The name of the variant that fuses the first kernels, from 3x3 on."""
    if count == len(SIZES):
        return BASE
    return single(SIZES[0]) if count == 1 else f"{count} fused kernels"


def study() -> list[Variant]:
    """The variants, in the order in which they are trained: what is most asked about first."""
    base = _base()
    plain = without_branches(base)
    resolutions = _multi_resolution(base)
    return [
        Variant(spec=base),
        _predicted("KP", base, 13, blocks=6),
        Variant(spec=_with(base, "wskp-3", blocks=3)),
        _predicted("KP-2", base, 7, blocks=5),
        _predicted("KP-1", base, 13, blocks=2),
        Variant(spec=dataclasses.replace(plain, name="wskp-6, no branches")),
        Variant(spec=_with(base, "6 kernels of 13x13", sizes=(13,) * len(SIZES))),
        Variant(spec=_reseeded(base)),
        *(
            Variant(spec=_with(base, name, sizes=sizes))
            for name, sizes in (
                (single(13), (13,)),
                (single(3), (3,)),
                (fused(3), SIZES[:3]),
                (single(7), (7,)),
                (fused(2), SIZES[:2]),
                (fused(4), SIZES[:4]),
                (single(9), (9,)),
                (single(5), (5,)),
                (fused(5), SIZES[:5]),
                (single(11), (11,)),
            )
        ),
        Variant(spec=resolutions),
        Variant(spec=_with_kernel(resolutions, "MR-KP", 5), predicts=True),
    ]


COMPARISONS = (
    Comparison(
        title="Kernels that neighbours share, against kernels predicted directly",
        source="Fan et al. 2021, tables 1 to 4 and 6, and table 7 of the supplement; wskp-6 is the "
        "paper's six-layer model, wskp-3 its three-layer model, with 6 fused kernels each; KP "
        "predicts 13x13 kernels with six blocks, KP-1 with two, KP-2 7x7 kernels with five; "
        "wskp-mr is its multi-resolution model, a U-Net with fused kernels of 3x3 and 5x5 at each "
        "of three resolutions, where MR-KP predicts 5x5 kernels with the same U-Net",
        variants=(BASE, "wskp-3", "KP", "KP-1", "KP-2", MULTI_RESOLUTION, "MR-KP"),
    ),
    Comparison(
        title="One kernel",
        source="figure 9, first row",
        variants=tuple(single(size) for size in SIZES),
    ),
    Comparison(
        title="Fused kernels, 3x3 first and each two pixels wider",
        source="figures 9 and 10",
        variants=tuple(fused(count) for count in KERNEL_COUNTS),
    ),
    Comparison(
        title="Fused kernels of one size",
        source="supplement, table 5",
        variants=(BASE, "6 kernels of 13x13"),
    ),
    Comparison(
        title="Convolutions trained side by side",
        source="table 5",
        variants=(BASE, "wskp-6, no branches"),
    ),
    Comparison(
        title="The same model from other random numbers",
        source="not in the paper: differences below this one say nothing",
        variants=(BASE, OTHER_SEED),
    ),
)


def _base() -> ModelSpec:
    spec = _with(load(BASE), BASE)
    training = dataclasses.replace(spec.training, steps=_STEPS, batch=_BATCH, patch=_PATCH)
    # as in the papers: multiplied by the frame's own albedo
    temporal = dataclasses.replace(spec.temporal, albedo_samples=0.0)
    return dataclasses.replace(spec, training=training, temporal=temporal)


def _with(
    spec: ModelSpec, name: str, *, blocks: int = 6, sizes: tuple[int, ...] = SIZES
) -> ModelSpec:
    assert isinstance(spec.network, ImportanceNetwork)
    return dataclasses.replace(
        spec,
        name=name,
        aliases=(),
        differs=(),  # prose about the model that is shipped
        network=dataclasses.replace(
            spec.network,
            widths=(_WIDTH,) * (blocks - 1),
            kernel_sizes=spec.network.kernel_sizes[:1] * blocks,
        ),
        decoder=spec.decoder.with_kernels(sizes),
    )


def _predicted(name: str, spec: ModelSpec, size: int, *, blocks: int) -> Variant:
    return Variant(spec=_with(spec, name, blocks=blocks, sizes=(size,)), predicts=True)


def _multi_resolution(base: ModelSpec) -> ModelSpec:
    """The multi-resolution model, trained as the base is."""
    spec = load(MULTI_RESOLUTION)
    assert isinstance(spec.network, PyramidNetwork)
    return dataclasses.replace(
        spec,
        aliases=(),
        differs=(),
        inputs=base.inputs,
        demodulate=base.demodulate,
        transfer=base.transfer,
        temporal=base.temporal,
        network=dataclasses.replace(spec.network, features=base.network.features),
        training=base.training,
    )


def _with_kernel(spec: ModelSpec, name: str, size: int) -> ModelSpec:
    return dataclasses.replace(spec, name=name, decoder=spec.decoder.with_kernels((size,)))


def _reseeded(spec: ModelSpec) -> ModelSpec:
    training = dataclasses.replace(spec.training, seed=spec.training.seed + 1)
    return dataclasses.replace(spec, name=OTHER_SEED, training=training)


#: Every graph of its own, and each number of kernels; the others take as long as one of these.
TIMED = tuple(
    dict.fromkeys(
        [
            *COMPARISONS[0].variants,
            *(fused(count) for count in KERNEL_COUNTS),
            single(13),
            "6 kernels of 13x13",
        ]
    )
)
