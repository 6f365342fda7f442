"""What the test of the extension does within Blender: ``python in_blender.py ZIP FOLDER``.

Runs where ``bpy`` is, with nothing of this project but what the extension brings. What it finds
goes to ``FOLDER/found.json``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

ZIP, FOLDER = Path(sys.argv[1]), Path(sys.argv[2])
# nothing of the user's is touched; set before Blender starts
os.environ["BLENDER_USER_RESOURCES"] = str(FOLDER / "user")

import bpy  # noqa: E402, I001  (it brings the next)
import addon_utils  # noqa: E402
import numpy as np  # noqa: E402

# Blender has OpenImageIO where it looks for modules; as a module from PyPI it does not look there
sys.path += [str(p) for p in Path(bpy.__file__).parent.glob("*/python/lib/*/site-packages")]

WIDTH, HEIGHT, FRAMES, LOOPS = 70, 47, 3, 200
MODULE = "bl_ext.user_default.stillray"
found: dict[str, object] = {}


def scene_of_a_cube() -> bpy.types.Scene:
    """Blender's first scene, with a camera that moves."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)  # settings, as add-ons, stay
    scene = bpy.context.scene
    camera = scene.camera
    for frame, x in ((0, 7.4), (10, 7.9)):
        camera.location.x = x
        camera.keyframe_insert("location", frame=frame)
    render = scene.render
    render.engine, scene.cycles.device = "CYCLES", "CPU"
    render.resolution_x, render.resolution_y = WIDTH, HEIGHT
    scene.cycles.samples, scene.cycles.seed = 2, 3
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.frame_start, scene.frame_end = 1, FRAMES
    return scene


def as_exr(scene: bpy.types.Scene, folder: str, *, depth: str = "32") -> Path:
    """Renders go to multilayer files in a folder."""
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", depth
    scene.render.filepath = str(FOLDER / folder / "f_")
    return FOLDER / folder


def animation(scene: bpy.types.Scene, folder: str, *, depth: str = "32", on: bool = True) -> Path:
    """Render all frames."""
    path = as_exr(scene, folder, depth=depth)
    scene.stillray.enabled = on
    bpy.ops.render.render(animation=True)
    return path


def engine_methods() -> list[str]:
    import cycles

    kind = cycles.CyclesRender
    return [getattr(kind, name).__module__ for name in ("render", "render_frame_finish")]


def state() -> dict[str, object]:
    """All of Blender that the extension touches."""
    names = ("render_init", "render_complete", "render_cancel")
    return {
        "methods": engine_methods(),
        "handlers": [len(getattr(bpy.app.handlers, name)) for name in names],
        "types": [name for name in dir(bpy.types) if "tillray" in name],
        "scene": hasattr(bpy.types.Scene, "stillray"),
        "operators": [name for name in dir(bpy.ops.stillray) if not name.startswith("_")],
    }


def resident() -> float:
    """MiB of this process now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def channels(path: Path) -> dict[str, np.ndarray]:
    from stillray.io.exr.file import ExrFile

    file = ExrFile.open(path)
    return file.read(list(file.channels))


def picture(path: Path) -> np.ndarray:
    planes = channels(path)
    return np.stack([planes[f"ViewLayer.Combined.{c}"] for c in "RGB"], axis=-1)


def by_the_api(
    folder: Path, *, temporal: bool, ensemble: int = 1, told: dict | None = None
) -> list[np.ndarray]:
    """What stillray itself makes of saved renders, and of what is told beside."""
    import stillray

    frames = (replace(stillray.read_exr(p), **(told or {})) for p in sorted(folder.glob("*.exr")))
    with stillray.Denoiser("high", temporal=temporal, ensemble=ensemble) as denoiser:
        return [denoiser.denoise(frame) for frame in frames]


def worst(pictures: list[np.ndarray], folder: Path) -> float:
    """The largest relative difference of files' pictures from others."""
    files = sorted(folder.glob("*.exr"))
    assert len(files) == len(pictures), folder
    pairs = [(picture(path), want) for path, want in zip(files, pictures, strict=True)]
    return max(float((np.abs(a - b) / (np.abs(b) + 1e-3)).max()) for a, b in pairs)


def others_differ(a: Path, b: Path) -> list[str]:
    """Channels beside the picture that are not the same to the bit, or not in both."""
    wrong = set()
    for path in sorted(a.glob("*.exr")):
        one, two = channels(path), channels(b / path.name)
        wrong |= one.keys() ^ two.keys()
        for name in one.keys() & two.keys():
            same = np.array_equal(one[name], two[name], equal_nan=True)
            if not same and name not in {f"ViewLayer.Combined.{c}" for c in "RGB"}:
                wrong.add(name)
    return sorted(wrong)


def install() -> None:
    bl_pkg = Path(addon_utils.paths()[0]) / "bl_pkg" / "cli" / "blender_ext.py"
    command = [sys.executable, str(bl_pkg), "validate", str(ZIP)]
    found["blender validates"] = subprocess.run(command, check=False).returncode == 0
    found["before"] = state()
    bpy.ops.extensions.package_install_files(
        filepath=str(ZIP), repo="user_default", enable_on_install=True
    )
    found["enabled"] = MODULE in bpy.context.preferences.addons
    found["wrapped"] = engine_methods()


def try_hook_and_operator() -> None:
    scene = scene_of_a_cube()
    found["passes changed"] = bpy.ops.stillray.set_up_passes() == {"FINISHED"}
    layer = scene.view_layers[0]
    found["passes"] = layer.use_pass_vector, layer.cycles.denoising_store_passes
    noisy = animation(scene, "noisy", on=False)
    clean = animation(scene, "clean")
    want = by_the_api(noisy, temporal=True)
    found["hook, float"] = worst(want, clean)
    found["hook, half"] = worst(want, animation(scene, "half", depth="16"))
    found["hook changed"] = worst([picture(p) for p in sorted(noisy.glob("*.exr"))], clean)
    found["hook, other passes"] = others_differ(noisy, clean)
    scene.stillray.temporal = False
    found["alone"] = worst(by_the_api(noisy, temporal=False), animation(scene, "alone"))
    scene.stillray.ensemble = 2
    both = by_the_api(noisy, temporal=False, ensemble=2)
    found["ensemble"] = worst(both, animation(scene, "ensemble"))
    scene.stillray.ensemble = 1
    scene.cycles.pixel_filter_type = "BOX"
    boxed = animation(scene, "boxed", on=False)
    want_boxed = by_the_api(boxed, temporal=False, told={"filter_spread": 12**-0.5})
    found["box filter"] = worst(want_boxed, animation(scene, "clean box"))
    untold = by_the_api(boxed, temporal=False)
    found["box taken for Blender's usual filter"] = worst(untold, FOLDER / "clean box")
    scene.cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    scene.stillray.temporal = scene.render.use_persistent_data = True
    found["data kept"] = worst(want, animation(scene, "kept"))
    scene.cycles.use_auto_tile, scene.cycles.tile_size = True, 32
    found["tiled"] = worst(want, animation(scene, "tiled"))
    scene.cycles.use_auto_tile = False
    as_exr(scene, "noisy")
    found["operator ended"] = list(bpy.ops.stillray.denoise_animation())
    found["operator"] = worst(want, noisy / "denoised")
    found["operator, other passes"] = others_differ(noisy, noisy / "denoised")
    named = str(FOLDER / "named" / "out_##.exr")
    (FOLDER / "named").mkdir()
    bpy.ops.stillray.denoise_animation(output_filepath=named)
    found["names"] = sorted(path.name for path in (FOLDER / "named").iterdir())
    from bl_ext.user_default.stillray.sequence import SequenceJob, files_of

    (FOLDER / "stopped").mkdir()
    job = SequenceJob(
        files_of(scene, "", str(FOLDER / "stopped") + "/"), quality="fast", temporal=True
    )
    job.cancel()  # what Esc does
    job.start()
    job.wait()
    found["stopped"] = [job.cancelled, job.error, job.done < FRAMES]
    try:
        bpy.ops.stillray.denoise_animation(input_filepath=str(FOLDER / "none.exr"))
    except RuntimeError as error:
        found["no file"] = str(error)


def try_eyes_and_layers() -> None:
    """Two eyes, two view layers and a border at once, each with a history of its own."""
    import stillray
    from stillray.io.exr.file import ExrFile

    scene = scene_of_a_cube()
    scene.view_layers.new("Second").samples = 5
    bpy.ops.stillray.set_up_passes()
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x = 0.2, 0.9
    render.border_min_y, render.border_max_y = 0.1, 0.8
    scene.frame_end = 2
    render.use_multiview, render.views_format = True, "STEREO_3D"
    as_exr(scene, "")
    render.image_settings.views_format = "MULTIVIEW"
    noisy, clean = animation(scene, "noisy eyes", on=False), animation(scene, "eyes")
    passes = {"color": "Combined", "motion": "Vector"}
    passes |= {role: f"Denoising {role.title()}" for role in ("albedo", "normal", "depth")}
    differences = {}
    for layer, samples in (("ViewLayer", 2), ("Second", 5)):
        for eye in ("left", "right"):
            chosen = {role: f"{layer}.{name}" for role, name in passes.items()} | {"view": eye}
            with stillray.Denoiser("high") as denoiser:
                for path in sorted(noisy.glob("*.exr")):
                    frame = stillray.read_exr(path, layers=chosen, samples=samples)
                    want = denoiser.denoise(frame)
                    file = ExrFile.open(clean / path.name, view=eye)
                    names = [f"{layer}.Combined.{c}" for c in "RGB"]
                    planes = file.read(names)
                    got = np.stack([planes[name] for name in names], axis=-1)
                    differences[f"{layer} {eye} {path.stem}"] = float(np.abs(got - want).max())
    found["eyes and layers"] = differences
    found["size"] = list(got.shape)


def try_loop() -> None:
    """Memory over many renders in one process, each by a call of its own."""
    scene = scene_of_a_cube()
    bpy.ops.stillray.set_up_passes()
    as_exr(scene, "loop")
    scene.stillray.enabled = True
    sizes = []
    for frame in range(1, LOOPS + 1):
        scene.frame_set(frame)
        bpy.ops.render.render()
        if frame % 20 == 0:
            sizes.append(round(resident(), 1))
    found["memory"] = sizes


def try_words() -> None:
    """Scenes without the passes, with motion blur, with a model that cannot be loaded."""
    from bl_ext.user_default.stillray import hook

    scene = scene_of_a_cube()
    scene.frame_end = 2
    bare = animation(scene, "bare noisy", on=False)
    words = found["words"] = {}
    words["bare"] = animation(scene, "bare"), sorted(hook.said)
    found["bare"] = worst(by_the_api(bare, temporal=False), FOLDER / "bare")
    bpy.ops.stillray.set_up_passes()
    scene.render.use_motion_blur = True
    words["blurred"] = animation(scene, "blurred"), sorted(hook.said)
    scene.render.use_motion_blur = False
    noisy, denoise = animation(scene, "noisy", on=False), hook.streams.denoise
    hook.streams.denoise = None
    words["broken"] = animation(scene, "broken"), sorted(hook.said)
    hook.streams.denoise = denoise
    untouched = [picture(noisy / f"f_000{frame}.exr") for frame in (1, 2)]
    found["broken"] = worst(untouched, FOLDER / "broken")


def uninstall() -> None:
    addon_utils.disable(MODULE, default_set=True)
    found["after"] = state()
    repos = bpy.context.preferences.extensions.repos
    index = next(i for i, repo in enumerate(repos) if repo.module == "user_default")
    bpy.ops.extensions.package_uninstall(repo_index=index, pkg_id="stillray")
    left = [p for p in (FOLDER / "user").rglob("*") if "stillray" in p.name or p.suffix == ".so"]
    found["files left"] = [str(path.relative_to(FOLDER)) for path in left]


def main() -> None:
    try:
        install()
        try_hook_and_operator()
        try_eyes_and_layers()
        try_words()
        try_loop()
        uninstall()
    finally:
        (FOLDER / "found.json").write_text(json.dumps(found, indent=1, default=str))


if __name__ == "__main__":
    main()
