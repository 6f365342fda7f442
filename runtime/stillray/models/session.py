"""ONNX Runtime, kept to itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray.models.network_graph import Interface, interface_of
from stillray.models.onnx_file import OnnxFile, parse_onnx, read_bytes
from stillray.models.protobuf import WireError
from stillray.models.steps import PLACES_KEY, layout_of


def read_checked(path: Path) -> tuple[OnnxFile, Interface]:
    """A model file, and what its network takes and gives; no session is made.

    Raises
    ------
    InputError
        The file is missing, is not ONNX, or holds what `stillray-export` does not write.
    """
    return checked(read_bytes(path), path)


def checked(data: bytes, origin: Path | str) -> tuple[OnnxFile, Interface]:
    """As `read_checked`, of a file's bytes; ``origin`` is what messages call them."""
    try:
        file = parse_onnx(data)
        interface = interface_of(file.graph)
        if interface.steps is not None:
            layout = layout_of(interface.steps, file.metadata.get(PLACES_KEY))
            interface = replace(interface, features=len(layout.columns), layout=layout)
        return file, interface
    except (WireError, ValueError) as error:
        raise InputError(f"{origin}: not a usable ONNX model: {error}") from None


#: An execution provider of ONNX Runtime: its name, or its name and its options.
Provider = str | tuple[str, Mapping[str, Any]]
#: What runs unless others are asked for.
CPU = "CPUExecutionProvider"


def open_session(
    path: Path,
    *,
    threads: int,
    providers: tuple[Provider, ...] | None = None,
    flush_denormals: bool = False,
    trace: Path | None = None,
) -> Any:
    """An ONNX Runtime session with set threads.

    Parameters
    ----------
    path
        The .onnx file.
    threads
        Threads of one operator.
    providers
        Execution providers by name, or name and options; an unknown one is an error, never a
        silent fallback.
    flush_denormals
        Take denormals for zero; the calling thread does so too from then on.
    trace
        Beginning of the name of a file for ONNX Runtime's own profile, in which nodes appear as
        they are in the file: the graph is not optimised.

    Raises
    ------
    InputError
        The file cannot be loaded, holds what `stillray-export` does not write, or a provider is
        not installed.
    """
    # Imported on use: `import stillray` loads no inference engine.
    import onnxruntime as ort

    file, _ = read_checked(path)
    options = session_options(threads, flush_denormals=flush_denormals)
    if trace is not None:
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.enable_profiling = True
        options.profile_file_prefix = str(trace)
    # the very bytes that were checked
    return start_session(file.data, path, options, providers)


def start_session(
    data: bytes, path: Path, options: Any, providers: tuple[Provider, ...] | None
) -> Any:
    """A session of a graph that was checked, on these providers or none.

    Parameters
    ----------
    data
        The graph.
    path
        What messages call it.
    options
        Of ONNX Runtime.
    providers
        As `open_session` takes them.

    Raises
    ------
    InputError
        ONNX Runtime refuses the graph, or a provider is not installed or does not start.
    """
    import onnxruntime as ort

    chosen = providers or (CPU,)
    wanted = provider_names(providers)
    available = ort.get_available_providers()
    if missing := [name for name in wanted if name not in available]:
        raise InputError(f"providers must be among {', '.join(available)}, got {missing[0]}")
    try:
        given = [item if isinstance(item, str) else (item[0], dict(item[1])) for item in chosen]
        session = ort.InferenceSession(data, options, providers=given)
    except Exception as error:  # ONNX Runtime's own, without a common base
        raise InputError(f"{path}: not a usable ONNX model: {first_line(error)}") from None
    if (got := session.get_providers()[: len(wanted)]) != wanted:
        raise InputError(f"providers must all start, asked for {wanted}, got {got}")
    return session


def provider_names(providers: Sequence[Provider] | None) -> list[str]:
    """The names of providers, without their options."""
    return [item if isinstance(item, str) else item[0] for item in providers or (CPU,)]


def session_options(threads: int, *, flush_denormals: bool = False) -> Any:
    """What all sessions have in common, and whether denormals are taken for zero."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.log_severity_level = 4  # what goes wrong is raised, and told in one line
    # a plan of all tensors in one block is laid out for the worst of sizes, beside what the arena
    # holds by then: a sixth to a quarter more memory and no less time, see docs/decisions.md
    options.enable_mem_pattern = False
    # denoising is called between a host's own work: idle threads must not burn its cores
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if flush_denormals:
        options.add_session_config_entry("session.set_denormal_as_zero", "1")
    return options


def first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
