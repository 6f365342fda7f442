"""The study as data: variants of one model, trained alike, and the comparisons they are made for.

All start from the specification of `BASE`, or of `MULTI_RESOLUTION`, and differ from it in what
their names say: features, accumulation, demodulation, loss, patches and steps are the same. Those
for many samples are trained on stills instead and scored on stills of `STILL_SAMPLES`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from stillray.model_spec import ModelSpec, load
from stillray.model_spec.networks import ImportanceNetwork, PyramidNetwork
from stillray_training.families import FAMILIES, Family
from stillray_training.networks.repvgg import without_branches
from stillray_training.peers import (
    fused_prediction,
    kernel_prediction,
    multi_resolution_prediction,
)

BASE = "wskp-6"
MULTI_RESOLUTION = "wskp-mr"
PAPER_INPUT = "wskp-6, the paper's input"
ONE_LAYER = "MR-KP of one layer"
BASE_FAMILY = "weight-sharing-kernels"
#: Scored on a single frame, too: accumulation off.
ONE_FRAME = (BASE, "wskp-3", "KP")
SIZES = (3, 5, 7, 9, 11, 13)  # pixels, of the six fused kernels
_WIDTH = 16  # channels between blocks
KERNEL_COUNTS = (1, 2, 3, 4, 5, 6, 8, 10)
#: Samples a pixel of the stills that variants for many samples are scored on.
STILL_SAMPLES = 64
# Short, so that the whole study fits into an hour of one core; the rest is the base's recipe.
STEPS, _BATCH, _PATCH = 600, 4, 64
#: What the networks of Fan et al. 2021 read, section 5.1.
PAPER_FEATURES = (
    "ldr.r", "ldr.g", "ldr.b", "albedo.r", "albedo.g", "albedo.b",
    "scaled_normal.x", "scaled_normal.y", "scaled_normal.z", "depth",
)  # fmt: skip
#: By the family of the model that a peer stands beside.
_PREDICTIONS = {
    "weight-sharing-kernels": kernel_prediction.FAMILY,
    "multi-resolution-kernels": multi_resolution_prediction.FAMILY,
}
#: One frame of many samples, no past (Fan et al. 2021, section 6.2).
_STILLS = "64 samples"


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One model of the study.

    Attributes
    ----------
    spec
        What it is; its name is the variant's.
    predicts
        Whether every pixel's kernel is predicted, not made from an importance map. The spec is
        that of the model which the peer stands beside; where it has several kernel sizes, kernels
        of each are predicted and fused.
    seed
        Which of the trainings with other random numbers, 1 for the first.
    """

    spec: ModelSpec
    predicts: bool = False
    seed: int = 1

    @property
    def name(self) -> str:
        """The name in tables, the same for all seeds."""
        return self.spec.name

    @property
    def stills(self) -> bool:
        """Whether it is trained and scored on single frames of many samples."""
        return self.spec.training.still_share == 1

    @property
    def family(self) -> Family:
        """Network and reconstruction for training."""
        if not self.predicts:
            return FAMILIES[self.spec.family]
        if self.spec.family == BASE_FAMILY and len(self.spec.decoder.fused_sizes) > 1:
            return fused_prediction.FAMILY
        return _PREDICTIONS[self.spec.family]

    def with_seed(self, seed: int) -> Variant:
        """The same from other random numbers: weights, patches and their order."""
        training = dataclasses.replace(
            self.spec.training, seed=self.spec.training.seed + seed - self.seed
        )
        spec = dataclasses.replace(self.spec, training=training)
        return dataclasses.replace(self, spec=spec, seed=seed)


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


def at_many(name: str) -> str:
    """The name of a variant for many samples."""
    return f"{name}, {_STILLS}"


def sizes_of(count: int) -> tuple[int, ...]:
    """Sizes of so many fused kernels, pixels: 3, and each two more than the one before."""
    return tuple(range(3, 3 + 2 * count, 2))


def study(seeds: int = 1, steps: int = STEPS) -> list[Variant]:
    """The variants, in the order in which they are trained: what is most asked about first.

    Parameters
    ----------
    seeds
        How often each is there, from other random numbers; all of a seed before the next.
    steps
        Of every training.
    """
    once = _once(steps)
    return [variant.with_seed(seed) for seed in range(1, seeds + 1) for variant in once]


def _once(steps: int) -> list[Variant]:
    base = _base(steps)
    kernels = _predicted("KP", base, 13, blocks=6)
    resolutions = _multi_resolution(base)
    predicted = Variant(spec=_with_kernel(resolutions, "MR-KP", 5), predicts=True)
    return [
        Variant(spec=base),
        kernels,
        Variant(spec=_with(base, "wskp-3", blocks=3)),
        _predicted("KP-2", base, 7, blocks=5),
        _predicted("KP-1", base, 13, blocks=2),
        _without_branches(Variant(spec=base)),
        Variant(spec=_with(base, "6 kernels of 13x13", sizes=(13,) * len(SIZES))),
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
        predicted,
        _without_branches(kernels),
        Variant(spec=_with(base, "KP-fusion"), predicts=True),
        _of_one_layer(predicted),
        _with_input(Variant(spec=base), PAPER_INPUT, PAPER_FEATURES),
        *(_for_many(one) for one in (Variant(spec=resolutions), predicted, kernels)),
        *(
            Variant(spec=_with(base, fused(count), sizes=sizes_of(count)))
            for count in KERNEL_COUNTS
            if count > len(SIZES)
        ),
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
        variants=(BASE, "wskp-6, no branches", "KP", "KP, no branches"),
    ),
    Comparison(
        title="Predicted kernels, fused",
        source="supplement, table 5: KP-fusion predicts a kernel of each of the six sizes and a "
        "share for each",
        variants=("KP", "KP-fusion", BASE),
    ),
    Comparison(
        title="What the network reads",
        source="Section 5.1: ten planes, radiance with its albedo as displayed, albedo, normals in "
        "[0, 1] and depth; ours are twelve, light without albedo, its local mean and the samples "
        "held among them",
        variants=(BASE, PAPER_INPUT),
    ),
    Comparison(
        title="Many samples, one frame",
        source="Table 4 and the supplement's tables 7 to 10. Trained on single frames of 1 sample "
        "a pixel to as many as the data hold, and scored on stills of "
        f"{STILL_SAMPLES}; neither has a past",
        variants=(at_many(MULTI_RESOLUTION), at_many("MR-KP"), at_many("KP")),
    ),
    Comparison(
        title="MR-KP of one layer",
        source="Meng et al. 2020, tables 1 to 3. Their supplement, which describes it, was not at "
        "hand: here each level has the convolution that enters it and the one that gives its "
        "kernels, and none between",
        variants=("MR-KP", ONE_LAYER),
    ),
)


def _base(steps: int) -> ModelSpec:
    spec = _with(load(BASE), BASE)
    training = dataclasses.replace(spec.training, steps=steps, batch=_BATCH, patch=_PATCH)
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


def _without_branches(variant: Variant) -> Variant:
    spec = dataclasses.replace(without_branches(variant.spec), name=f"{variant.name}, no branches")
    return dataclasses.replace(variant, spec=spec)


def _with_input(variant: Variant, name: str, features: tuple[str, ...]) -> Variant:
    network = variant.spec.network
    assert isinstance(network, ImportanceNetwork)
    network = dataclasses.replace(network, features=features)
    spec = dataclasses.replace(variant.spec, name=name, network=network)
    return dataclasses.replace(variant, spec=spec)


def _of_one_layer(variant: Variant) -> Variant:
    network = variant.spec.network
    assert isinstance(network, PyramidNetwork)
    levels = len(network.widths)
    network = dataclasses.replace(
        network,
        encoder_blocks=(0,) * levels,
        decoder_blocks=(0,) * (levels - 1),
        # nothing follows that would bring joined planes back to a level's width
        concatenate=(False,) * (levels - 1),
    )
    spec = dataclasses.replace(variant.spec, name=ONE_LAYER, network=network)
    return dataclasses.replace(variant, spec=spec)


def _for_many(variant: Variant) -> Variant:
    training = dataclasses.replace(variant.spec.training, still_share=1.0, quiet_share=0.0)
    spec = dataclasses.replace(variant.spec, name=at_many(variant.name), training=training)
    return dataclasses.replace(variant, spec=spec)


#: Every graph of its own, and each number of kernels; the others take as long as one of these.
TIMED = tuple(
    dict.fromkeys(
        [
            *COMPARISONS[0].variants,
            *(fused(count) for count in KERNEL_COUNTS),
            single(13),
            "6 kernels of 13x13",
            "KP-fusion",
            ONE_LAYER,
        ]
    )
)
