"""A room imports lower floors only; the runtime knows neither training nor export, training no
export; nothing imports in circles. All of this also where an import is lazy or for types. No
function of the runtime is long."""

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from stillray.model_spec import loader

ROOT = Path(__file__).parents[1]
#: Packages from the ground up, and their folders.
PACKAGES = {"stillray": "runtime", "stillray_training": "training", "stillray_export": "export"}
#: Rooms of `stillray`, from the ground up; the package itself, a list of names, looks at all.
FLOORS = [
    {"errors", "version", "timing", "pixel_filter", "arrays"},
    {"frame", "model_spec"},
    {"stages", "models", "io"},
    {"families"},
    {"pipeline"},
    {"batch", "compare", "oidn", "mitsuba"},
    {"profiling"},
    {"cli", "demo"},
    {"__main__", "__init__"},
]
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
#: What the runtime lives without.
OUTSIDE = {"torch", "mitsuba"}
#: A metric of an extra, whose library is made of torch; loaded when the metric is asked for.
ALLOWED = {("stillray.compare.metrics", "torch")}


@cache  # half a second of processor time for all of them, and the tests look six times
def imports_in(source: str) -> list[ast.Import | ast.ImportFrom]:
    """The import statements of a source, anywhere in it."""
    nodes = ast.walk(ast.parse(source))
    return [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]


def imported(source: str, modules: set[str]) -> set[str]:
    """Names of modules that a source imports, anywhere in it; of ours, the very modules."""
    found = set()
    for node in imports_in(source):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        else:
            assert node.level == 0, "imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in modules else str(node.module))
    return found


def sources(*packages: str) -> dict[str, str]:
    """Texts of the modules of some packages, all unless named."""
    paths = {}
    for folder in (ROOT / PACKAGES[package] for package in packages or PACKAGES):
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            paths[".".join(parts).removesuffix(".__init__")] = path
    return {module: path.read_text(encoding="utf-8") for module, path in paths.items()}


def floor(module: str) -> tuple[int, int]:
    """How high a module of ours lies: its package, and of the runtime the room's floor."""
    package, _, rest = module.partition(".")
    room = rest.split(".")[0] or "__init__"
    return list(PACKAGES).index(package), FLOOR[room] if package == "stillray" else 0


def broken(texts: dict[str, str]) -> list[str]:
    """What breaks the rules, in words."""
    wrong = []
    modules = set(texts)
    for module, text in sorted(texts.items()):
        for target in sorted(imported(text, modules)):
            if (module, target) in ALLOWED:
                continue
            package = target.split(".")[0]
            if package in PACKAGES and floor(target) > floor(module):
                wrong.append(f"{module} imports {target}, which lies above")
            elif package in OUTSIDE and module.split(".")[0] == "stillray":
                wrong.append(f"{module} imports {target}")
    return wrong


def test_rooms_import_lower_floors_only():
    assert broken(sources()) == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("stillray.stages.accumulate", "    from stillray.pipeline import denoiser"),
        ("stillray.families.box_filter", "    import stillray.batch.run"),
        ("stillray.io.atomic", "    from stillray import Denoiser"),
        ("stillray.cli.tradeoff", "    from stillray_training.tradeoff import measure"),
        ("stillray.arrays.strips", "    import torch"),
        ("stillray_training.patch_training", "    from stillray_export.to_onnx import export"),
    ],
)
def test_one_forbidden_import_is_found_even_in_a_function(module, line):
    texts = sources()
    texts[module] += f"\ndef lazy():\n{line}\n"
    assert [text.split()[0] for text in broken(texts)] == [module]


def require_no_circle(texts: dict[str, str]) -> None:
    """Raises a `CycleError`, which names the modules of a circle."""
    modules = set(texts)
    graph = {
        module: {name for name in imported(text, modules) if name in modules and name != module}
        for module, text in texts.items()
    }
    TopologicalSorter(graph).prepare()


def test_no_module_imports_itself_by_way_of_others():
    require_no_circle(sources())


def test_a_circle_is_found_even_in_a_function():
    texts = sources()
    texts["stillray_training.schedule"] += "\ndef f():\n    import stillray_training.train\n"
    with pytest.raises(CycleError, match=r"stillray_training\.schedule"):
        require_no_circle(texts)


#: Options of specifications, of which a family has its own.
OPTIONS = {
    kind.__name__
    for family in loader.FAMILIES.values()
    for kind in (family.network, family.decoder)
}
CONSTRUCTORS = ("__init__", "__post_init__")


def asks_for_options(function: ast.FunctionDef) -> bool:
    """Whether a function looks which options it was given."""
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
            kinds = {name.id for name in ast.walk(node.args[1]) if isinstance(name, ast.Name)}
            if kinds & OPTIONS:
                return True
    return False


def narrowed(texts: dict[str, str]) -> list[str]:
    """Functions but constructors that look which options they were given."""
    return [
        name
        for module, text in sorted(texts.items())
        for name, function in functions(module, text).items()
        if name.split(".")[-1] not in CONSTRUCTORS and asks_for_options(function)
    ]


def test_specifications_are_narrowed_in_constructors_only():
    assert narrowed(sources("stillray", "stillray_export")) == []


_A_NETWORK = "makes a network of one family, as a constructor does"
_A_DECODER = "reconstructs for one family, by the signature that all families have in training"
_A_STUDY = "of one family, whose options it changes or prints"
#: Functions of training that look all the same, and why.
NARROWED_IN_TRAINING = {
    "stillray_training.ablation.variants._multi_resolution": _A_STUDY,
    "stillray_training.ablation.variants._of_one_layer": _A_STUDY,
    "stillray_training.ablation.variants._with": _A_STUDY,
    "stillray_training.ablation.variants._with_input": _A_STUDY,
    "stillray_training.families._fused": _A_DECODER,
    "stillray_training.families._grids": _A_DECODER,
    "stillray_training.families._multires": _A_DECODER,
    "stillray_training.families._pyramid": _A_DECODER,
    "stillray_training.grid_study.changes": _A_STUDY,
    "stillray_training.grid_study.main": _A_STUDY,
    "stillray_training.grid_study.times": _A_STUDY,
    "stillray_training.network_maps.maps_of": "tells families apart by what they say",
    "stillray_training.networks.multi_branch.multi_branch_net": _A_NETWORK,
    "stillray_training.networks.pyramid.kernel_pyramid_net": _A_NETWORK,
    "stillray_training.networks.pyramid.multi_resolution_net": _A_NETWORK,
    "stillray_training.networks.single_branch.single_branch_net": _A_NETWORK,
    "stillray_training.peers.fused_prediction._decode": _A_DECODER,
    "stillray_training.peers.fused_prediction._network": _A_NETWORK,
    "stillray_training.peers.kernel_prediction.options_of": "a peer's options, of its model's",
    "stillray_training.peers.multi_resolution_prediction._decode": _A_DECODER,
    "stillray_training.peers.multi_resolution_prediction._network": _A_NETWORK,
    "stillray_training.upscaling.clip.load_clip": "of the one family that has clips",
    "stillray_training.upscaling.study.variants": _A_STUDY,
}


def test_training_narrows_specifications_in_few_functions_more():
    assert set(narrowed(sources("stillray_training"))) <= NARROWED_IN_TRAINING.keys()


def test_one_function_that_asks_for_options_is_found():
    text = "class A:\n    def f(self, s):\n        assert isinstance(s.decoder, A | FusedKernels)\n"
    assert narrowed({"stillray.x": text}) == ["stillray.x.A.f"]
    assert narrowed({"stillray.x": text.replace("def f", "def __init__")}) == []


MOST_LINES, MOST_PARAMETERS = 60, 6
#: Signatures that are somebody else's, or that users type out by name.
LONG_SIGNATURES = {
    "stillray.cli.compare.compare": "options of the command line",
    "stillray.cli.denoise.denoise": "options of the command line",
    "stillray.cli.profile.profile": "options of the command line",
    "stillray.mitsuba.Denoiser.__init__": "as Mitsuba's OptixDenoiser",
    "stillray.mitsuba.Denoiser.__call__": "as Mitsuba's OptixDenoiser",
    "stillray.oidn.convenience.denoise": "as pyoidn's",
    "stillray.oidn.filter.Filter.set_image": "as pyoidn's",
    "stillray.pipeline.denoiser.Denoiser.__init__": "by names, all but the model left out",
    "stillray.pipeline.denoiser.denoise": "the buffers of a frame, a name each",
}


def functions(module: str, text: str) -> dict[str, ast.FunctionDef]:
    """Functions and methods of a module by their full name, inner ones too."""
    found = {}

    def visit(node: ast.AST, name: str) -> None:
        for child in ast.iter_child_nodes(node):
            inner = f"{name}.{child.name}" if hasattr(child, "name") else name
            if isinstance(child, ast.FunctionDef):
                found[inner] = child
            visit(child, inner)

    visit(ast.parse(text), module)
    return found


def parameters(function: ast.FunctionDef) -> int:
    """How many it has, without the object that a method belongs to."""
    given = function.args
    listed = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    listed += [more for more in (given.vararg, given.kwarg) if more is not None]
    return len(listed) - (bool(listed) and listed[0].arg in ("self", "cls"))


def lines(function: ast.FunctionDef) -> int:
    """Its lines, without its docstring's."""
    first = function.body[0]
    has_docstring = ast.get_docstring(function, clean=False) is not None
    told = first.end_lineno - first.lineno + 1 if has_docstring else 0
    return function.end_lineno - function.lineno + 1 - told


def too_much(texts: dict[str, str]) -> list[str]:
    """Functions that are too long, or ask for too much."""
    wrong = []
    for module, text in sorted(texts.items()):
        for name, function in functions(module, text).items():
            if name in LONG_SIGNATURES:
                continue
            if parameters(function) > MOST_PARAMETERS or lines(function) > MOST_LINES:
                wrong.append(f"{name}: {parameters(function)} parameters, {lines(function)} lines")
    return wrong


def test_no_function_is_long_or_asks_for_much():
    assert too_much(sources("stillray")) == []


def test_exceptions_are_of_functions_that_need_them():
    texts = sources("stillray")
    found = {
        name: function
        for module, text in texts.items()
        for name, function in functions(module, text).items()
    }
    assert all(parameters(found[name]) > MOST_PARAMETERS for name in LONG_SIGNATURES)


@pytest.mark.parametrize(
    "text",
    [
        "def f(a, b, c, *, d, e, g, h=1):\n    pass\n",
        "class A:\n    def f(self, a, b, c, d, e, *f, **g):\n        pass\n",
        "def f():\n    def g(a):\n" + "        a += 1\n" * 60,
    ],
)
def test_a_long_function_is_found(text):
    assert too_much({"stillray.x": text})


#: What other libraries name so, though it is for everybody.
NOT_PRIVATE = {"_exit", "_replace", "_asdict", "_fields"}


def is_private(name: object) -> bool:
    return (
        isinstance(name, str)
        and name.startswith("_")
        and not name.startswith("__")
        and name[1:].isidentifier()
        and name not in NOT_PRIVATE
    )


def private_names(text: str) -> list[str]:
    """Names of others' insides that a test imports, reads or patches; its own classes' aside."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            parts = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            found += [part for name in parts for part in name.split(".") if is_private(part)]
        elif isinstance(node, ast.Attribute) and is_private(node.attr):
            if not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")):
                found.append(node.attr)
        elif isinstance(node, ast.Call) and "attr" in ast.unparse(node.func):
            words = [word.value for word in node.args if isinstance(word, ast.Constant)]
            found += [word for word in words if is_private(word)]
    return found


def test_tests_look_at_nothing_private():
    found = {
        str(path.relative_to(ROOT)): names
        for path in (ROOT / "tests").rglob("*.py")
        if (names := private_names(path.read_text(encoding="utf-8")))
    }
    assert found == {}


@pytest.mark.parametrize(
    "line",
    [
        "from stillray.frame import _checked",
        "from stillray import _frame",
        "import stillray._frame",
        "denoiser._strips = 1",
        "made().part._strips",
        "monkeypatch.setattr(denoiser, '_strips', 1)",
        "getattr(denoiser, '_strips')",
    ],
)
def test_one_private_name_is_found(line):
    assert private_names(line)
    assert not private_names("from __future__ import annotations\nself._a = b.__name__\n_c = 1")
