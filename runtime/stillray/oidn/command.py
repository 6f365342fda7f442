"""The command `oidnDenoise`: its options, its files and its exit codes, with stillray behind it."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from stillray.errors import InputError
from stillray.io.image_file import check_suffix, read_image, write_image
from stillray.oidn.filtering import FILTER_TYPES, Parameters, filtered, model_for
from stillray.pipeline.denoiser import Denoiser
from stillray.version import __version__

_QUALITIES = {
    "default": "high", "h": "high", "high": "high", "b": "balanced", "balanced": "balanced",
    "f": "fast", "fast": "fast",
}  # fmt: skip
_TYPES = {"f": "float", "float": "float", "fp32": "float",
          "h": "half", "half": "half", "fp16": "half"}  # fmt: skip
_FAILED = 1  # for whatever goes wrong, as there


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> None:  # type: ignore[override]
        raise InputError(message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments
        Without the program's name; None for the process's own.

    Returns
    -------
    int
        0 done, 1 failed; a failure is one line on standard error.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = _parser()
    if not given:
        parser.print_usage(sys.stderr)
        return _FAILED
    try:
        _run(parser.parse_args(_with_two_dashes(given)))
    except InputError as error:
        told = str(error).replace("max_memory must", "maxmem must")  # its name here
        print("Error: " + " ".join(told.split()), file=sys.stderr)
        return _FAILED
    return 0


def _with_two_dashes(arguments: Sequence[str]) -> list[str]:
    """One dash or two, all names may have either; values never begin with one."""
    return ["--" + a.lstrip("-") if a.startswith("-") else a for a in arguments]


def _one_of(choices: dict[str, str]) -> Callable[[str], str]:
    def parse(text: str) -> str:
        if text.lower() not in choices:
            # argparse takes any ValueError for its own, and says less
            raise argparse.ArgumentTypeError(f"must be one of {', '.join(choices)}, got {text}")
        return choices[text.lower()]

    return parse


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="oidnDenoise",
        description="Denoise one image with stillray, by the options of oidnDenoise. Images are "
        "PFM, PHM or EXR files.",
        allow_abbrev=False,
        add_help=False,
    )
    add = parser.add_argument
    add("--help", "--h", action="help", help="print this")
    color = parser.add_mutually_exclusive_group()
    color.add_argument("--hdr", type=Path, metavar="FILE", help="scene-linear radiance")
    color.add_argument("--ldr", type=Path, metavar="FILE", help="linear values in [0, 1]")
    color.add_argument("--dir", type=Path, metavar="FILE", help="directional lightmap, [-1, 1]")
    add("--srgb", action="store_true", help="the values of --ldr are sRGB; so is the output")
    add("--alb", "--albedo", type=Path, metavar="FILE", help="albedo, [0, 1]")
    add("--nrm", "--normal", type=Path, metavar="FILE", help="normals, [-1, 1]")
    add("--output", "--out", "--o", type=Path, metavar="FILE", help="where the picture goes")
    add("--filter", "--f", choices=FILTER_TYPES, default="RT", help="RT, RTLightmap")
    add("--quality", "--q", type=_one_of(_QUALITIES), default="high", metavar="NAME",
        help="default, high, balanced, fast")  # fmt: skip
    add("--threads", type=int, metavar="N", help="all processors unless given")
    add("--maxmem", "--maxMemoryMB", type=int, default=-1, metavar="MIB",
        help="denoise in tiles, so that this much suffices beside the images")  # fmt: skip
    add("--verbose", "--v", type=int, default=1, metavar="0-3", help="0: print errors only")
    add("--list_devices", "--list-devices", "--listDevices", "--ld", action="store_true",
        help="print the devices there are")  # fmt: skip
    parser.add_argument("--clean_aux", "--clean-aux", "--cleanAux", action="store_true",
        help="albedo has no noise: it is not filtered first")  # fmt: skip
    ignored = parser.add_argument_group("taken and ignored, which is said")
    ignored.add_argument("--device", "--dev", "--d", default="default", metavar="NAME")
    ignored.add_argument("--is", "--input_scale", "--input-scale", "--inputScale", type=float,
                         dest="input_scale", metavar="X")  # fmt: skip
    ignored.add_argument("--type", "--t", type=_one_of(_TYPES), default="float",
                         metavar="NAME")  # fmt: skip
    ignored.add_argument("--affinity", type=int, metavar="0|1")
    ignored.add_argument("--inplace", action="store_true")
    ignored.add_argument("--n", "--bench", type=int, dest="runs", metavar="N")
    return parser


def _run(options: argparse.Namespace) -> None:
    if options.list_devices:
        print("Device 0\n  Name: this machine's processors (stillray)\n  Type: CPU")
        return
    paths = {
        "color": options.hdr or options.ldr or options.dir,
        "albedo": options.alb,
        "normal": options.nrm,
    }
    paths = {role: path for role, path in paths.items() if path is not None}
    if not paths:
        raise InputError("an input image must be given: --hdr FILE, --ldr FILE or --dir FILE")
    if options.output is not None:  # told before the work, not after it
        check_suffix(options.output)
    images = {role: read_image(path, role) for role, path in paths.items()}
    parameters = Parameters(
        filter_type=options.filter,
        hdr=options.hdr is not None,
        srgb=options.srgb,
        directional=options.dir is not None,
        clean_aux=options.clean_aux,
        max_memory_mb=options.maxmem,
    )
    if ignored := _ignored(options):
        print(f"ignored: {', '.join(ignored)}", file=sys.stderr)
    start = time.perf_counter()
    model = model_for(images, options.quality)
    with Denoiser(model, threads=options.threads, temporal=False) as denoiser:
        picture = filtered(images, parameters, denoiser)
        if options.verbose > 0:
            height, width = picture.shape[:2]
            print(f"stillray {__version__}, {denoiser.model.name}: {width}x{height}, "
                  f"{1e3 * (time.perf_counter() - start):.0f} ms")  # fmt: skip
        if options.verbose > 1:
            for stage, milliseconds in denoiser.last_timings.items():
                print(f"  {stage}: {milliseconds:.1f} ms")
    if options.output is not None:
        write_image(options.output, picture, like=paths.get("color"))


def _ignored(options: argparse.Namespace) -> list[str]:
    """What was asked for and changes nothing, with the reason."""
    reasons = {
        f"--device {options.device} (runs on the CPU)": options.device.lower()
        not in ("default", "cpu", "0"),
        "--is (exposure is found)": options.input_scale is not None,
        "--type half (computed in float)": options.type == "half",
        "--affinity": options.affinity is not None,
        "--srgb (for --ldr only)": options.srgb and options.ldr is None,
        "--dir is denoised as --ldr (directional with --filter RTLightmap only)": options.dir
        is not None
        and options.filter != "RTLightmap",
        "--n (runs once)": options.runs is not None and options.runs > 1,
    }
    return [reason for reason, applies in reasons.items() if applies]
