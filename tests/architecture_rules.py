"""The rules of ARCHITECTURE.md and CONTRIBUTING.md on the source tree: each returns its offenders as lines of text."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator, Mapping

from tests.source_tree import Module, SourceTree

LAYERS = (
    "shared terms", "kernels", "networks", "files", "plans", "tasks",
    "workflows", "runs", "measurements", "user interface",
)  # fmt: skip
"""Lowest first; a module imports from its own layer and from those before it."""

FOLDERS = {
    "core": "shared terms",
    "temporal": "kernels", "relight": "kernels", "decompose": "kernels", "scene": "kernels", "metrics": "kernels",
    "gaussians": "kernels",
    "io": "files", "capture": "files", "capture_stage": "files", "blender_set": "files", "training": "files",
    "planning": "plans",
    "tasks": "tasks",
    "workflows": "workflows",
    "runtime": "runs", "inspect": "runs",
    "measure": "measurements",
    "report": "user interface", "cli": "user interface", "__main__": "user interface",
}  # fmt: skip

NETWORKS = (
    "checkpoint", "cosmos", "diffusion_renderer", "embedded", "identity", "latents", "marigold", "published",
    "registry", "rgbx", "weights",
)  # fmt: skip
"""Modules of decompose/ that find and read weights; the ensemble reaches them through a protocol alone."""

EVALUATION_TASKS = (
    "tasks",
    "bounce_task",
    "sequence_tasks",
    "measured_tasks",
    "fitted_tasks",
    "fitted_rows",
    "evidence_rows",
    "scorer",
    "scene",
    "subjects",
    "rows",
    "nets",
    "pictures",
    "task_records",
)
"""Modules of the evaluation that run on workers; they know nothing of drivers and sessions."""

CAPTURE_KERNELS = ("agreement", "carving", "consistent", "hull", "matting", "reduced", "undistort", "usable", "volume")
"""Modules of capture/ that are pure functions of arrays."""

MODULES = {
    **{f"capture.{name}": "kernels" for name in CAPTURE_KERNELS},
    **{f"decompose.{name}": "networks" for name in NETWORKS},
    **{f"measure.evaluation.{name}": "tasks" for name in EVALUATION_TASKS},
    "temporal.spynet": "networks",
    "workflows.evaluate": "measurements",
}
"""Modules of another layer than their folder's."""

OTHER_INTERPRETERS = "inside_"
"""Folders whose modules run in the Python of Blender and others: they import nothing of the package."""

GRANTED_IMPORTS = {
    ("relight.envmap", "io.env_maps"): "EnvMap.open is a constructor of the public interface",
}
"""Upward imports that are there on purpose."""

FILE_LIBRARIES = frozenset(
    "dask distributed zarr OpenImageIO OpenEXR subprocess logging multiprocessing shutil tempfile safetensors".split()
)
FILE_CALLS = frozenset(
    "open .open .read_text .read_bytes .write_text .write_bytes .unlink .rename .mkdir .glob .rglob .kill".split()
)
GRANTED_FILES = {
    ("core.camera", ".read_text"): "Camera.open is a constructor of the public interface",
    ("core.fault_points", ".unlink"): "a fault that a test plants takes its token away",
    ("core.fault_points", ".kill"): "a fault that a test plants kills the process",
    **{
        ("core.kernel_cache", what): "Numba reads the folder of machine code when a kernel is declared"
        for what in (".glob", ".mkdir", ".read_bytes", "shutil", "tempfile")
    },
    **{
        ("core.kernel_sources", what): "the folder is named by a digest of the sources"
        for what in (".glob", ".read_text")
    },
}
"""What kernels do with files and processes on purpose, by module and by what is imported or called."""

MAX_FILE_LINES, MAX_FUNCTION_LINES, MAX_PARAMETERS = 400, 50, 8

WORDS = {
    "glow": "indirect radiance",
    "opinion": "auxiliary predictor",
    "survey": "global context",
    "heard": "auxiliary predictor",
    "trust(?! region)": "confidence (data weight), damping (solver) or shrinkage (estimator)",
    "shel(?:f|ves)": "LRU cache",
    "reels?": "video segment",
    "(?!(?-i:FiLM))films?(?! set)": "pixel filter (reconstruction filter) or video",
    "judg": "scorer",
    "outfit": "garments",
}
"""Word that is not used, as a pattern of its beginning or with `s?` of the whole word, and what is written instead."""

NAMES = {"things?": "procedural objects"}
"""The same for identifiers alone."""

WORDS_OF_FOLDERS = {
    "measure": {"labs?": "experiment harness"},
    "temporal": {"loose": "unconverged", "silent": "inconsistent"},
}
"""The same where a word has another meaning elsewhere (CIELAB)."""

PHRASES = ("as ever", "whoever", "beside that", "stands? before", "told by hand", "on its desk", "is told", "are told")
"""Archaic turns that are not used in docstrings."""


def layer_of(name: str) -> str | None:
    """The layer of a module, by its own row or its folder's; None if it has neither."""
    return MODULES.get(name) or FOLDERS.get(name.partition(".")[0] if name else "__main__")


def ours(tree: SourceTree) -> Iterator[Module]:
    """Modules that run in our own interpreter."""
    return (m for m in tree.modules if not any(p.startswith(OTHER_INTERPRETERS) for p in m.name.split(".")))


def without_layer(tree: SourceTree) -> Iterator[str]:
    """Modules that no row of the tables places, and rows that place no module."""
    yield from (f"{module} has no layer" for module in tree.modules if layer_of(module.name) is None)
    names = {module.name for module in tree.modules}
    yield from (f"the row {name} has no module" for name in MODULES if name not in names)


def upward_imports(tree: SourceTree) -> Iterator[str]:
    """Imports from a layer above, inside functions and for type checkers too."""
    level = {name: number for number, name in enumerate(LAYERS)}
    for module, imported in sorted(tree.edges.items()):
        for other in sorted(imported):
            here, there = layer_of(module), layer_of(other)
            upward = here is not None and there is not None and level[there] > level[here]
            if upward and (module, other) not in GRANTED_IMPORTS:
                yield f"{module} ({here}) imports {other} ({there})"


def imports_from_other_interpreters(tree: SourceTree) -> Iterator[str]:
    """What runs in another Python has none of our packages."""
    inside = {module.name for module in tree.modules} - {module.name for module in ours(tree)}
    yield from (f"{name} imports {other}" for name in sorted(inside) for other in sorted(tree.edges[name] - inside))


def files_in_kernels(tree: SourceTree) -> Iterator[str]:
    """Files, processes, logs and Dask in the two lowest layers."""
    for module in ours(tree):
        if layer_of(module.name) not in LAYERS[:2]:
            continue
        libraries = {name.partition(".")[0] for name in module.imports} & FILE_LIBRARIES
        for found in sorted(libraries | (module.called & FILE_CALLS)):
            if (module.name, found) not in GRANTED_FILES:
                yield f"{module} uses {found}"


def idle_grants(tree: SourceTree) -> Iterator[str]:
    """Exceptions that nothing needs any more."""
    used = {module.name: {n.partition(".")[0] for n in module.imports} | module.called for module in tree.modules}
    yield from (f"{m} no longer imports {o}" for m, o in GRANTED_IMPORTS if o not in tree.edges.get(m, ()))
    yield from (f"{m} no longer uses {what}" for m, what in GRANTED_FILES if what not in used.get(m, ()))


def prints_below_the_command_line(tree: SourceTree) -> Iterator[str]:
    """Calls of `print`."""
    yield from (f"{m}" for m in ours(tree) if "print" in m.called and m.name.partition(".")[0] != "cli")


def cycles(tree: SourceTree) -> Iterator[str]:
    """Modules that import each other, in whatever way."""
    for start in sorted(tree.edges):
        reached, stack = set[str](), list(tree.edges[start])
        while stack:
            name = stack.pop()
            if name not in reached:
                reached.add(name)
                stack.extend(tree.edges[name])
        if start in reached:
            yield f"{start} imports itself through others"


def long_files(tree: SourceTree) -> Iterator[str]:
    """Files of more than `MAX_FILE_LINES` lines."""
    lengths = ((module, len(module.path.read_text(encoding="utf-8").splitlines())) for module in tree.modules)
    yield from (f"{module}: {lines} lines" for module, lines in lengths if lines > MAX_FILE_LINES)


def long_functions(tree: SourceTree) -> Iterator[str]:
    """Functions of more than `MAX_FUNCTION_LINES` lines, docstring aside."""
    yield from (f"{f}: {f.lines} lines" for f in tree.functions if f.lines > MAX_FUNCTION_LINES)


def many_parameters(tree: SourceTree) -> Iterator[str]:
    """Functions of more than `MAX_PARAMETERS` parameters; the command line's are its options."""
    many = (f for f in tree.functions if f.parameters > MAX_PARAMETERS)
    yield from (f"{f}: {f.parameters} parameters" for f in many if f.module.partition(".")[0] != "cli")


def without_docstring(tree: SourceTree) -> Iterator[str]:
    """Public modules, classes, functions and methods without a docstring."""
    for module in tree.modules:
        if ast.get_docstring(module.tree) is None:
            yield f"{module}"
        for name, node in module.documented:
            public = not any(part.startswith("_") for part in name.split("."))
            if public and ast.get_docstring(node) is None:
                yield f"{module}.{name}"


def forbidden_words(tree: SourceTree) -> Iterator[str]:
    """Words that have a standard term, in identifiers and docstrings."""
    for module in ours(tree):
        names = [re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", name) for name in module.identifiers]
        words = WORDS | WORDS_OF_FOLDERS.get(module.name.partition(".")[0], {})
        yield from (f"{module}: {w}, write {words[w]}" for w in words if _holds(w, [*names, *module.docstrings]))
        yield from (f"{module}: {w}, write {NAMES[w]}" for w in NAMES if _holds(w, names))


def archaic_phrases(tree: SourceTree) -> Iterator[str]:
    """Turns of phrase that a reader has to decipher."""
    for module in tree.modules:
        yield from (f"{module}: {phrase}" for phrase in PHRASES if _holds(f"{phrase}(?![a-z])", module.docstrings))


def _holds(pattern: str, texts: Iterable[str]) -> bool:
    """Whether a text has a word that begins with the pattern; patterns that end in `s?` are whole words."""
    end = r"(?![a-z])" if pattern.endswith("s?") else ""
    found = re.compile(rf"(?<![A-Za-z])(?:{pattern}){end}", re.I)
    return any(found.search(" ".join(text.split())) for text in texts)


RULES: Mapping[str, Callable[[SourceTree], Iterator[str]]] = {
    rule.__name__: rule
    for rule in (
        without_layer, upward_imports, imports_from_other_interpreters, files_in_kernels, idle_grants,
        prints_below_the_command_line, cycles, long_files, long_functions, many_parameters, without_docstring,
        forbidden_words, archaic_phrases,
    )
}  # fmt: skip
