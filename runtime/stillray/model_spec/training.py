"""The table of a specification for how its weights are learned."""

from __future__ import annotations

from dataclasses import dataclass

from stillray.errors import InputError
from stillray.model_spec.rules import one_of, within

OPTIMISERS = ("adam", "muon")
LAYERS = ("color", "albedo")
_MAX_COUNT = 10**9  # steps and the like, of training


@dataclass(frozen=True, kw_only=True)
class Training:
    """The recipe that `stillray-train` follows."""

    steps: int
    batch: int
    patch: int  # pixels
    learning_rate: float  # of the optimiser, cosine decay to 1 % of it
    smape_epsilon: float  # Fan et al. 2021, eq. 6, in exposed radiance
    display_weight: float  # weight of the error as displayed beside SMAPE, >= 0
    # weight of its square there, which is what PSNR counts, >= 0
    squared_weight: float
    structure_weight: float  # weight of one minus the structural similarity, >= 0
    steady_weight: float  # weight of the change against the previous output, >= 0
    quiet_share: float  # share of patches of little noise and a few fireflies, [0, 1]
    history_from: int  # step from which previous outputs are given; 0: the model takes none
    history_every: int  # steps between renewals of those outputs
    drop_feature: float  # probability that albedo, normal or depth is withheld from a patch
    exposure_stops: float  # exposure is varied by +- this
    seed: int
    # What follows may be left out: models that were exported before it was known lack it.
    # weights of errors of slopes, and of means of 4x4 and 16x16 pixels, as displayed, >= 0
    slope_weight: float = 0.0
    blur_weight: float = 0.0
    hinge_weight: float = 0.0  # weight of squares further off than the input was, >= 0
    # Patches weigh by their input's error as displayed to the power of minus this: with 0.5 those
    # that begin with a hundredth of the error count ten times as much. [0, 1]
    quiet_power: float = 0.0
    average: float = 0.0  # decay of the mean of weights over steps, which is what is kept; 0: none
    # Whether the network's convolutions run so where the processor can: half the time, less exact
    bfloat16: bool = False
    still_share: float = 0.0  # share of patches of single frames of 2 to 32 samples a pixel, [0, 1]
    layer: str = "color"  # one of LAYERS: what of a frame is learned to be denoised
    alone: bool = False  # whether no patch has a past: for a model of single frames
    # share of patches of a recurrent model that have neither jitter nor roughness nor specular
    # albedo, as most renderers write them, [0, 1]
    plain_share: float = 0.0
    # share of patches of a recurrent model over which a shadow or a bright patch moves, or whose
    # light is switched, [0, 1]
    shade_share: float = 0.0
    # share of patches of a recurrent model whose texture changes, or whose albedo is black in
    # places, [0, 1]
    paint_share: float = 0.0
    # share of patches of a recurrent model with fireflies, [0, 1]
    firefly_share: float = 0.0
    # share of patches of a recurrent model, of those where nothing moves, whose frames are means of
    # several, as of samples all over their pixels, [0, 1]
    mean_share: float = 0.0
    # share of sequences into which small lamps are painted, of models of patches, [0, 1]
    lamp_share: float = 0.0
    # share of sequences into which glints are painted, lamps that a part of the samples meets, of
    # models of patches, for frames without a past, [0, 1]
    glint_share: float = 0.0
    # share of sequences in which a surface mirrors soft light, as varnish does, of models of
    # patches, [0, 1]
    sheen_share: float = 0.0
    # share of sequences into which a bright window behind thin bars is painted, of models of
    # patches, [0, 1]
    window_share: float = 0.0
    # share of sequences into which thin shadows are painted that stay where they are in the frame,
    # of models of patches, for frames without a past, [0, 1]
    shadow_share: float = 0.0
    # share of sequences, or of patches of a recurrent model, that samples of a heavy tail are
    # painted into, as of renderers that clamp none, [0, 1]
    tail_share: float = 0.0
    # share of sequences of whose samples a part stays and counts as much more, so that they are as
    # noisy as scenes that are harder to light, of models of patches, [0, 1]
    thin_share: float = 0.0
    # share of sequences that are seen through a lens that is wide open, or in which things move
    # while the shutter is open, of models of patches, [0, 1]
    defocus_share: float = 0.0
    # share of sequences over whose albedo a fine texture is painted, of models that denoise that,
    # [0, 1]
    texture_share: float = 0.0
    # share of sequences over whose albedo a texture with detail of every size is painted, which a
    # few samples a pixel meet, of models that denoise albedos, [0, 1]
    leaf_share: float = 0.0
    # share of sequences over whose albedo a page of print lies, which a few samples a pixel meet,
    # of models that denoise albedos, [0, 1]
    page_share: float = 0.0
    # share of sequences over which a soft pattern of 4 to 48 pixels is painted that no feature
    # shows, of models of patches, [0, 1]
    ripple_share: float = 0.0
    # share of sequences into which things are painted of which each sample draws a material, as of
    # glass, of models that denoise albedos, [0, 1]
    mixture_share: float = 0.0
    # share of batches whose patches have 32, 48 or 64 pixels a side, so that pictures are met whose
    # coarser levels have next to no pixels, of models of patches, [0, 1]
    small_share: float = 0.0
    # steps after which one more sequence is drawn anew (its blocks, counts and what is painted into
    # it), of models of patches without a past; 0: none is
    redraw_every: int = 0
    frames: int = 1  # that a recurrent model is unrolled over
    warm_frames: int = 0  # most frames before those, which are run and not learned from
    fresh_share: float = 0.0  # share of batches that have none of those, [0, 1]
    weight_decay: float = 0.0  # decoupled, see `torch.optim.AdamW`; >= 0
    optimiser: str = "adam"  # one of OPTIMISERS
    albedo_weight: float = 0.0  # weight of the error of accumulated albedos, >= 0
    smape_weight: float = 1.0  # weight of SMAPE itself, >= 0
    # weight of the error after a filmic curve, which Meng et al. 2020 train by, >= 0
    filmic_weight: float = 0.0
    mean_weight: float = 0.0  # weight of how far a patch's mean as displayed is off, >= 0

    def __post_init__(self) -> None:
        for key in (
            "display_weight", "squared_weight", "structure_weight", "steady_weight",
            "slope_weight", "blur_weight", "hinge_weight", "weight_decay", "albedo_weight",
            "smape_weight", "filmic_weight", "mean_weight",
        ):  # fmt: skip
            within(f"training.{key}", getattr(self, key), 0, 1e3)
        for key in (
            "quiet_power", "average", "still_share", "quiet_share", "drop_feature", "plain_share",
            "shade_share", "paint_share", "firefly_share", "lamp_share", "fresh_share",
            "mean_share", "small_share", "window_share", "shadow_share", "tail_share",
            "thin_share", "defocus_share", "texture_share", "mixture_share",
            "glint_share", "leaf_share", "page_share", "sheen_share", "ripple_share",
        ):  # fmt: skip
            within(f"training.{key}", getattr(self, key), 0, 1)
        for key in ("steps", "batch", "patch", "frames"):
            within(f"training.{key}", getattr(self, key), 1, _MAX_COUNT)
        for key in ("history_from", "history_every", "seed", "warm_frames", "redraw_every"):
            within(f"training.{key}", getattr(self, key), 0, _MAX_COUNT)
        if self.redraw_every and self.history_from:
            raise InputError(
                "training.redraw_every must be 0 where previous outputs are given, whose frames "
                f"stay as they are (training.history_from {self.history_from}), "
                f"got {self.redraw_every}"
            )
        one_of("training.optimiser", self.optimiser, OPTIMISERS)
        one_of("training.layer", self.layer, LAYERS)
        within("training.learning_rate", self.learning_rate, 1e-12, 1e3)
        within("training.smape_epsilon", self.smape_epsilon, 1e-12, 1e6)
        within("training.exposure_stops", self.exposure_stops, 0, 32)
