"""``stillray compare``: images and their reference on one page that opens in any browser."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillray.compare import MAX_MEGAPIXELS
from stillray.errors import InputError

if TYPE_CHECKING:
    from stillray.compare.page import Summary
    from stillray.compare.sources import Sources


def compare(
    images: Annotated[
        list[str],
        typer.Argument(metavar="IMAGE...", help="EXR or PFM files, or sequences as 'a.####.exr'."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The HTML page to write.")],
    reference: Annotated[
        str | None,
        typer.Option("--reference", "-r", help="What the images should be: metrics, error maps."),
    ] = None,
    label: Annotated[
        list[str] | None, typer.Option("--label", help="Name of an image; repeat in their order.")
    ] = None,
    title: Annotated[str | None, typer.Option(help="Heading of the page.")] = None,
    frames: Annotated[
        str | None, typer.Option(help="Frames of sequences, as 1,10-80,90-99x3.", metavar="RANGE")
    ] = None,
    crop: Annotated[
        str | None, typer.Option(help="Only this part, pixels.", metavar="X,Y,WIDTH,HEIGHT")
    ] = None,
    layer: Annotated[
        list[str] | None,
        typer.Option("--layer", help="Show this layer too, as diffuse or depth.Z; repeatable."),
    ] = None,
    view: Annotated[
        str | None, typer.Option(help="Of files with several views, as left and right: which.")
    ] = None,
    downscale: Annotated[
        int, typer.Option(help="Show 1/N of the size; metrics are of every pixel all the same.")
    ] = 1,
    max_megapixels: Annotated[
        float, typer.Option(help="Limit of the pixels on the page, all images and frames.")
    ] = MAX_MEGAPIXELS,
) -> None:
    """Compare images on one self-contained HTML page."""
    from stillray.compare.carried import Region
    from stillray.compare.page import write_page
    from stillray.compare.sources import pair
    from stillray.io.file_sequence import refuse_overwriting

    if output.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"output must be an .html file, got {output}")
    sources = pair(images, reference, labels=label or (), frames=frames)
    paths = [path for frame in sources.frames for path in (*frame.images, frame.reference) if path]
    refuse_overwriting([output], paths)
    if sources.left_out:
        print(
            f"left out, not in every sequence: {', '.join(map(str, sources.left_out))}",
            file=sys.stderr,
        )
    summary = write_page(
        output,
        sources,
        title=title,
        region=Region(
            crop=_parse_crop(crop), downscale=downscale, view=view, layers=tuple(layer or ())
        ),
        max_megapixels=max_megapixels,
    )
    _print_figures(sources, summary)
    print(f"{output}: {summary.size_bytes / 1e6:.1f} MB")


def _parse_crop(crop: str | None) -> tuple[int, int, int, int] | None:
    if crop is None:
        return None
    try:
        x, y, width, height = (int(part) for part in crop.split(","))
    except ValueError:
        raise InputError(f"--crop must be X,Y,WIDTH,HEIGHT in pixels, got {crop}") from None
    return x, y, width, height


def _print_figures(sources: Sources, summary: Summary) -> None:
    from rich.table import Table

    from stillray.cli.output import console
    from stillray.compare import scores

    shown = scores.columns(summary.values)
    if not shown:
        return
    table = Table(box=None, pad_edge=False)
    measured = sum(frame.reference is not None for frame in sources.frames)
    count = len(sources.frames)
    of_all = f"{count} frames"
    if measured < count:
        of_all = f"the {measured} of {count} with a reference"
    table.add_column("image" if count == 1 else f"mean of {of_all}")
    for metric in shown:
        table.add_column(metric.title, justify="right")
    rows = scores.table(summary.values, shown)
    for label, row in zip(sources.labels, rows, strict=True):
        table.add_row(label, *(cell.text for cell in row))
    console().print(table)
    if any(cell.text == "–" for row in rows for cell in row):
        print("– where pixels are not finite, or nothing is to measure by: see the page")
