"""A demo folder in Python, Node and Chromium: milliseconds, processor time, parity.

stillray-export kpyr-5s --frame-graph
python plugins/web/demo/build.py kpyr-5s.frame.onnx demo_web
python plugins/web/demo/measure.py demo_web

Node runs where npm has installed onnxruntime-node; Chromium needs playwright. Each runs alone, in
one thread. ``--webgpu`` adds WebGPU in software, and tells which nodes run on it.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from stillray.frame import Frame
from stillray.models.registry import find_frame_model
from stillray.pipeline.denoiser import Denoiser

WEB = Path(__file__).parents[1]
#: Where Debian, Ubuntu and others put it.
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
#: WebGPU without a GPU: SwiftShader's Vulkan.
_SOFTWARE_WEBGPU = (
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--enable-features=Vulkan",
)
_SECONDS = 3600  # that a sequence may take
_EQUAL = 290  # dB, to the last bit
# Lines of ONNX Runtime's log: a provider, then each of its nodes.
_PROVIDER = re.compile(r" placed on \[(\w+)\]")
_NODE = re.compile(r"VerifyEachNodeIsAssignedToAnEp\]\s+(\w+) \(")


@dataclass(frozen=True, kw_only=True)
class Played:
    """A sequence that was denoised.

    Attributes
    ----------
    where
        By what, in words.
    milliseconds
        Of each frame.
    processor
        Seconds of processor time a frame, after the first where there are more.
    pictures
        ``(h, w, 3)`` each.
    """

    where: str
    milliseconds: list[float]
    processor: float
    pictures: list[np.ndarray]


def read_frames(folder: Path) -> list[Frame]:
    """What ``build.write_frames`` has written."""
    about = json.loads((folder / "sequence.json").read_text())
    size = about["height"], about["width"]
    frames = []
    for index in range(about["count"]):
        values, start, buffers = np.fromfile(folder / f"{index}.f32", "<f4"), 0, {}
        for name, channels in about["buffers"].items():
            end = start + channels * size[0] * size[1]
            planes = values[start:end].reshape(*size, channels)
            buffers[name] = planes if channels > 1 else planes[..., 0]
            start = end
        frames.append(Frame(**buffers))
    return frames


def in_python(folder: Path) -> Played:
    """ONNX Runtime's own library, one thread."""
    frames, milliseconds, processor, pictures = read_frames(folder / "frames"), [], [], []
    with Denoiser(find_frame_model(folder / "model.onnx"), threads=1) as denoiser:
        for frame in frames:
            start, busy = time.perf_counter(), time.process_time()
            pictures.append(denoiser.denoise(frame).copy())
            milliseconds.append(1e3 * (time.perf_counter() - start))
            processor.append(time.process_time() - busy)
    return Played(
        where="Python",
        milliseconds=milliseconds,
        processor=float(np.mean(processor[1:] or processor)),
        pictures=pictures,
    )


def in_node(folder: Path) -> Played:
    """The package on onnxruntime-node."""
    with tempfile.TemporaryDirectory() as out:
        command = ["node", WEB / "test/sequence.mjs", folder / "model.onnx", folder / "frames", out]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode:
            raise RuntimeError(run.stderr)
        told = json.loads(run.stdout)
        frames = read_frames(folder / "frames")
        pictures = [
            np.fromfile(f"{out}/{index}.f32", "<f4").reshape(*frame.shape, 3)
            for index, frame in enumerate(frames)
        ]
    return Played(
        where="Node",
        milliseconds=told["milliseconds"],
        processor=float(np.mean(told["processor"][1:] or told["processor"])),
        pictures=pictures,
    )


def in_chromium(folder: Path, provider: str = "wasm") -> Played:
    """The demo page, ``"wasm"`` or ``"webgpu"``."""
    with _page(folder, provider) as (browser, page, address):
        page.goto(f"{address}?provider={provider}")
        done = "window.played || window.failed"
        page.wait_for_function(
            f"{done} || document.getElementById('status').innerText.startsWith('Frame')",
            timeout=1e3 * _SECONDS,
        )
        busy, after = _processor_seconds(browser), page.inner_text("#status")
        page.wait_for_function(done, timeout=1e3 * _SECONDS)
        if failed := page.evaluate("window.failed"):
            raise RuntimeError(failed)
        shown = re.match(r"Frame (\d+) of (\d+)", after)
        first, count = map(int, shown.groups()) if shown else (0, 1)
        spent = (_processor_seconds(browser) - busy) / max(count - first, 1)
        frames = read_frames(folder / "frames")
        pictures = [
            np.array(
                page.evaluate(f"Array.from(window.played.pictures[{index}])"), np.float32
            ).reshape(*frame.shape, 3)
            for index, frame in enumerate(frames)
        ]
        return Played(
            where=f"Chromium {browser.version.split('.')[0]}, {provider}",
            milliseconds=page.evaluate("window.played.milliseconds"),
            processor=spent,
            pictures=pictures,
        )


def placed(folder: Path) -> dict[str, Counter[str]]:
    """The nodes, by operator, that each provider runs of the graph as ONNX Runtime optimises it."""
    found: dict[str, Counter[str]] = {}
    with _page(folder, "webgpu") as (_, page, address):

        def note(message: Any) -> None:
            if told := _PROVIDER.search(message.text):
                found[told[1]] = Counter()
            elif (told := _NODE.search(message.text)) and found:
                found[next(reversed(found))][told[1]] += 1

        page.on("console", note)
        page.goto(f"{address}frames/sequence.json")
        page.evaluate(
            """async (address) => {
                const ort = await import(`${address}ort/ort.webgpu.bundle.min.mjs`);
                ort.env.wasm.numThreads = 1;
                ort.env.logLevel = 'verbose';
                const options = {
                    executionProviders: ['webgpu'], logSeverityLevel: 0, logVerbosityLevel: 1,
                };
                await ort.InferenceSession.create(`${address}model.onnx`, options);
            }""",
            address,
        )
    return found


@contextmanager
def _page(folder: Path, provider: str) -> Iterator[tuple[Any, Any, str]]:
    """A browser, a page of it, and the address at which the folder is served."""
    from playwright.sync_api import sync_playwright

    arguments = _SOFTWARE_WEBGPU if provider == "webgpu" else ()
    with served(folder) as address, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(arguments))
        try:
            yield browser, browser.new_page(), address
        finally:
            browser.close()


def _processor_seconds(browser: Any) -> float:
    """Of all processes of a browser so far."""
    session = browser.new_browser_cdp_session()
    told = session.send("SystemInfo.getProcessInfo")["processInfo"]
    return float(sum(process["cpuTime"] for process in told))


class _Quiet(SimpleHTTPRequestHandler):
    extensions_map = SimpleHTTPRequestHandler.extensions_map | {".mjs": "text/javascript"}

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """A folder at an address of this machine."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()


def decibels(got: np.ndarray, wanted: np.ndarray) -> float:
    """Between two pictures, tone-mapped."""
    got, wanted = (image / (1 + image) for image in (got, wanted))
    return float(-10 * np.log10(np.square(got - wanted).mean() + 1e-30))


def row(played: Played, wanted: Played) -> str:
    """A line of the table; parity is of the worst frame."""
    pairs = zip(played.pictures, wanted.pictures, strict=True)
    worst = min(decibels(got, picture) for got, picture in pairs)
    parity = "equal" if worst > _EQUAL else f"{worst:.0f}"
    first, *later = played.milliseconds
    cells = (
        played.where,
        f"{first:.0f}",
        f"{np.median(later or [first]):.0f}",
        f"{1e3 * played.processor:.0f}",
        "" if played is wanted else parity,
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Parse the command line, run, print."""
    parser = argparse.ArgumentParser(description="Play a demo folder here and there.")
    parser.add_argument("folder", type=Path, help="made by build.py")
    parser.add_argument("--webgpu", action="store_true", help="WebGPU in Chromium too")
    given = parser.parse_args()
    wanted = in_python(given.folder)
    print("| | first frame, ms | later ones | processor time of these, ms | dB from Python's |")
    print("|---|---|---|---|---|")
    print(row(wanted, wanted), flush=True)
    if (WEB / "node_modules/onnxruntime-node").is_dir():
        print(row(in_node(given.folder), wanted), flush=True)
    for provider in ("wasm", "webgpu") if given.webgpu else ("wasm",):
        print(row(in_chromium(given.folder, provider), wanted), flush=True)
    if given.webgpu:
        for provider, nodes in placed(given.folder).items():
            listed = ", ".join(f"{count} {name}" for name, count in nodes.most_common())
            print(f"\n{provider} runs {nodes.total()} nodes: {listed}")


if __name__ == "__main__":
    main()
