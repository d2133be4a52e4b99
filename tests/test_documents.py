"""Documents tell the truth about the code: stage table, contract, defaults, figures, benchmarks."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import typer
import yaml

from tests.architecture_rules import FOLDERS, LAYERS, PHRASES, WORDS
from yesnt.core.camera import Camera
from yesnt.core.channels import CHANNELS, DELIVERED, MEASURED, ON_REQUEST, SET_LAYERS, STORED
from yesnt.core.shot import Shot
from yesnt.planning.stages import STAGES

ROOT = Path(__file__).parent.parent
BENCHMARKS = ROOT / "tests" / "benchmarks"
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "deploy").glob("*.md")])


@cache
def text_of(name: str) -> str:
    """A document by its path from the root."""
    return (ROOT / name).read_text()


def section(name: str, title: str) -> str:
    """The part of a document under a heading of level two."""
    found = re.search(rf"^## {re.escape(title)}.*?$(.*?)(?=^## |\Z)", text_of(name), re.M | re.S)
    assert found, f"{name} has no section {title!r}"
    return found.group(1)


def code_blocks(text: str, language: str) -> list[str]:
    """Fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)


# --- the stage table and the size of the architecture page


def stage_table() -> str:
    rows = ["| stage | a task holds | reads | writes | task, in `yesnt/tasks/` |", "|---|---|---|---|---|"]
    for stage in STAGES.values():
        files = dict.fromkeys(function.partition(":")[0].rpartition(".")[2] for function in stage.tasks.values())
        tasks = ", ".join(f"`{name}.py`" for name in files)
        rows.append(f"| {stage.name} | {stage.holds} | {stage.reads} | {', '.join(stage.writes)} | {tasks} |")
    return "\n".join(rows)


def test_stage_table_is_fresh() -> None:
    found = re.search(r"<!-- stages -->\n(.*?)<!-- /stages -->", text_of("ARCHITECTURE.md"), re.S)
    assert found
    assert found.group(1).strip() == stage_table()


def test_architecture_is_one_page() -> None:
    assert len(text_of("ARCHITECTURE.md").splitlines()) <= 120


def layer_rows() -> list[tuple[str, ...]]:
    """Folders of each row of the layer table, from the lowest layer up."""
    rows = re.findall(r"^\| [^|]+ \| ((?:`\w+/` ?)+)\|", section("ARCHITECTURE.md", "Layers"), re.M)
    return [tuple(re.findall(r"`(\w+)/`", row)) for row in rows]


def test_layer_table_is_the_one_that_the_architecture_test_checks() -> None:
    folders = [{folder for folder, layer in FOLDERS.items() if layer == name} - {"__main__"} for name in LAYERS]
    assert [set(row) for row in layer_rows()] == [row for row in folders if row]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_documents_use_the_terms_of_the_field(page: Path) -> None:
    """Code, which is renamed with the code, and the generated stage table are left out."""
    code = r"```.*?```|`[^`]*`|<!-- stages -->.*?<!-- /stages -->"
    prose = " ".join(re.sub(code, "", page.read_text(), flags=re.S).split())
    for word, term in {**WORDS, **dict.fromkeys(PHRASES, "plain English")}.items():
        end = r"(?![a-z])" if word.endswith("s?") else ""
        found = re.search(rf"(?<![A-Za-z])(?:{word}){end}.{{,30}}", prose, re.I)
        assert not found, f"{page.name}: {found.group()!r}; write {term}" if found else ""


# --- the contract


@cache
def commands() -> dict[str, typer.models.CommandInfo]:
    from yesnt.cli.app import app

    named = {command.name or getattr(command.callback, "__name__", ""): command for command in app.registered_commands}
    return {name.replace("_", "-"): command for name, command in named.items()}


def options_of(verb: str) -> set[str]:
    """Long options of a verb."""
    import typer.main

    from yesnt.cli.app import app

    group = typer.main.get_command(app)
    command = group.commands[verb]  # type: ignore[attr-defined]
    return {name for parameter in command.params for name in parameter.opts if name.startswith("--")}


def contract_verbs() -> dict[str, set[str]]:
    """Verbs of the contract's table and the options that it names."""
    cells = re.findall(r"^\| (`[^|]*(?:\\\|[^|]*)*) \|", section("docs/contract.md", "Command line"), re.M)
    rows = [row for cell in cells for row in re.findall(r"`([a-z-]+)([^`]*)`", cell)]
    return {verb: set(re.findall(r"--[a-z-]+", rest)) for verb, rest in rows}


def test_contract_names_every_verb_and_no_other() -> None:
    assert set(contract_verbs()) == set(commands())


@pytest.mark.parametrize("verb", sorted(contract_verbs()))
def test_contract_names_every_option_and_no_other(verb: str) -> None:
    assert contract_verbs()[verb] == options_of(verb) - {"--json"}


def test_contract_says_which_verbs_print_json() -> None:
    without = re.search(r"all verbs but (.*?)\)", section("docs/contract.md", "Command line"))
    assert without
    assert set(re.findall(r"`(\w+)`", without.group(1))) == {v for v in commands() if "--json" not in options_of(v)}


def test_roadmap_holds_nothing_that_works() -> None:
    text = text_of("docs/roadmap.md")
    assert "`yesnt gof" not in text
    future = {key for block in code_blocks(text, "yaml") for key in yaml.safe_load(block)}  # none, if all is built
    assert not (future & set(Shot.model_fields)) - {
        "plate",
        "gbuffer",
        "light",
        "decompose",
        "exr",
    }  # these gain keys only


def profile_table() -> str:
    from yesnt.runtime.launchers.profile import MODELS

    rows = ["| `kind:` | required | optional |", "|---|---|---|"]
    for kind, model in MODELS.items():
        keys = {name: field.is_required() for name, field in model.model_fields.items() if name != "kind"}
        cells = (", ".join(f"`{name}`" for name in keys if keys[name] is needed) for needed in (True, False))
        rows.append(f"| `{kind}` | {' | '.join(cells)} |".replace("|  |", "| |"))
    return "\n".join(rows)


def test_contract_names_every_key_of_a_cluster_profile() -> None:
    from yesnt.runtime.launchers.profile import KubernetesGpu, SlurmGpu, SshGpu

    text = section("docs/contract.md", "A cluster")
    found = re.search(r"<!-- profiles -->\n(.*?)<!-- /profiles -->", text, re.S)
    assert found
    assert found.group(1).strip() == profile_table()
    (line,) = (line for line in text.splitlines() if line.startswith("`gpu:` of"))
    for model, part in zip((SshGpu, SlurmGpu, KubernetesGpu), line.split("; "), strict=True):
        assert set(re.findall(r"`(\w+)`", part)) - {"ssh", "slurm", "kubernetes"} == set(model.model_fields)


def test_example_job_of_the_contract_is_accepted() -> None:
    whole, further = code_blocks(section("docs/contract.md", "A shot"), "yaml")
    shot = yaml.safe_load(whole)
    Shot.model_validate(shot)
    more = yaml.safe_load(further)
    for key, value in more.items():
        made = {"proxy"} if key == "gaussians" else set()  # what a field takes the place of
        needed = {"capture": more["capture"]} if key == "evidence" else {}
        Shot.model_validate({name: part for name, part in shot.items() if name not in made} | needed | {key: value})
    assert set(yaml.safe_load(whole)) | set(yaml.safe_load(further)) == set(Shot.model_fields)


def test_contract_names_the_required_keys() -> None:
    named = re.search(r"Required: (.*?)\.", section("docs/contract.md", "A shot"))
    assert named
    required = {name for name, field in Shot.model_fields.items() if field.is_required()}
    assert set(re.findall(r"`(\w+)`", named.group(1))) == required


def test_contract_names_every_key_of_a_section() -> None:
    text = section("docs/contract.md", "A shot")
    for name, field in Shot.model_fields.items():
        model = next((a for a in (field.annotation, *getattr(field.annotation, "__args__", ())) if has_fields(a)), None)
        for key in model.model_fields if model is not None else ():
            assert key in text, f"{name}.{key} is not in the contract"


def has_fields(annotation: object) -> bool:
    return hasattr(annotation, "model_fields")


def test_template_of_a_new_shot_says_what_the_contract_says(tmp_path: Path) -> None:
    from yesnt.io.embedded_shot import write_template

    text = write_template(tmp_path / "walk").read_text()
    keys = set(re.findall(r"^(?:# )?(\w+):", text, re.M))
    (example, _) = code_blocks(section("docs/contract.md", "A shot"), "yaml")
    assert keys == set(yaml.safe_load(example))
    given = yaml.safe_load(text)
    optional = re.sub(r"^# (\w+:.*?)(?:  +#.*)?$", r"\1", text, flags=re.M)
    Shot.model_validate(given)
    Shot.model_validate(yaml.safe_load("\n".join(line for line in optional.splitlines() if not line.startswith("#"))))


def test_example_camera_of_the_contract_is_read() -> None:
    text = section("docs/contract.md", "A shot")
    keys = re.search(r'`camera.json`: `\{("width".*?)"frames"', text)
    assert keys
    intrinsics = dict.fromkeys(re.findall(r'"(\w+)"', keys.group(1)), 8.0)
    pose = {"world_from_camera": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
    assert Camera.from_dict(intrinsics | {"frames": {"1001": pose}}).width == 8


def test_contract_names_every_delivered_channel() -> None:
    text = section("docs/contract.md", "What comes out")
    named = {"R", "G", "B", "A"}
    for stem, components in re.findall(r"`(?:(\w+)\.)?(\w+(?:/\w)*)`", text):
        named |= {f"{stem}.{c}" for c in components.split("/")} if stem else set()
    delivered = {
        channel for name in (*DELIVERED, *MEASURED, *SET_LAYERS, *ON_REQUEST) for channel in CHANNELS[name].exr
    }
    assert delivered <= named, delivered - named


def test_python_of_the_contract_is_callable() -> None:
    from yesnt.relight import Camera, EnvMap, GBuffer, shade
    from yesnt.temporal import EnergyParams, energy, solve

    (block,) = code_blocks(section("docs/contract.md", "Python"), "python")
    for call, line in {energy: "energy", solve: "solve", shade: "shade", GBuffer: "GBuffer"}.items():
        signature = re.search(rf"^{line}\((.*?)\)", block, re.M | re.S)
        assert signature
        written = [part.strip() for part in signature.group(1).split(",") if part.strip()]
        held = [
            name if parameter.default is inspect.Parameter.empty else f"{name}={parameter.default!r}".replace("'", '"')
            for name, parameter in inspect.signature(call).parameters.items()
        ]
        held = [default.replace("0.0001", "1e-4") for default in held]
        assert written == held[: len(written)], f"{line}: the code has {held}"
    assert callable(Camera.open)
    assert callable(EnvMap.open)
    assert callable(EnvMap.from_array)
    assert EnergyParams()


@pytest.mark.parametrize("page", [p for p in PAGES if "```python" in p.read_text()], ids=lambda p: p.name)
def test_python_on_the_pages_imports_and_calls_what_exists(page: Path) -> None:
    for block in code_blocks(page.read_text(), "python"):
        tree, known = ast.parse(block), {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                module = importlib.import_module(node.module)
                known |= {alias.name: getattr(module, alias.name) for alias in node.names}
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            function = known.get(getattr(call.func, "id", ""))
            if function is not None:
                given = {keyword.arg: None for keyword in call.keywords if keyword.arg}
                inspect.signature(function).bind(*call.args, **given)


# --- defaults of the method


def test_defaults_of_the_method_are_those_of_the_code() -> None:
    from yesnt.decompose.confidence import DIVISOR
    from yesnt.decompose.registry import ENTRIES
    from yesnt.decompose.settings import EnsembleSettings
    from yesnt.gaussians.mesh_settings import MeshSettings
    from yesnt.gaussians.settings import FitSettings
    from yesnt.relight.brdf import ALPHA_MIN, F0_DIELECTRIC, IOR
    from yesnt.relight.settings import RelightSettings
    from yesnt.temporal.bridging import BRIDGE
    from yesnt.temporal.flow import FlowSettings
    from yesnt.temporal.outliers import WINDOW, OutlierSettings
    from yesnt.temporal.params import EnergyParams

    fit = FitSettings()
    text = " ".join(text_of("docs/method.md").split())
    energy, flow, mesh = EnergyParams(), FlowSettings(), MeshSettings()
    said = {
        f"delta {energy.delta}, lambda1 {energy.lambda1}, lambda2 {energy.lambda2}, eps 1e-3": energy.eps == 1e-3,
        f"relative {flow.relative}, absolute {flow.absolute}, photometric {flow.photometric}": flow.cut == 0,
        f"flow method `{flow.method}`": True,
        f"clip(std / {DIVISOR}, 0, 1)": True,
        f"(`samples`, {EnsembleSettings().samples}; the embedded model {ENTRIES['embedded'].samples})": True,
        f"(`overlap`, {EnsembleSettings().overlap})": EnsembleSettings().antithetic,
        "alpha_ggx = max(r^2, 1e-3)": ALPHA_MIN == 1e-3,
        f"level set {mesh.level} (`level`)": mesh.smoothing == 0,
        f"boxes of {mesh.box:g} standard deviations (`box`)": True,
        f"opacity of at least {mesh.least_opacity} (`least_opacity`)": True,
        f"{mesh.bisections} halvings of each cut edge (`bisections`)": True,
        f"at least {mesh.least_part} of the largest one's area (`least_part`)": True,
        f"{mesh.triangles} triangles (`triangles`)": True,
        f"F0 = {F0_DIELECTRIC} (1 - metallic)": True,
        f"reflectance of IOR {IOR}": True,
        f"links beside a frame that is inconsistent as a whole weigh {BRIDGE:g} V^2".capitalize(): True,
        f"{OutlierSettings().limit:g} times (`limit`) what is usual within {WINDOW} frames": True,
        f"regions of {OutlierSettings().region} x {OutlierSettings().region} pixels": True,
        f"({RelightSettings().bounce} at standard quality)": True,
        f"coverage {fit.weights.matte} (`matte`, huber": True,
        f"consistency {fit.weights.consistency}, and 0 for": fit.weights.distortion + fit.weights.depth == 0,
        f"{fit.steps} steps (`steps`) from {fit.count} flat discs": True,
        f"every {fit.every} steps (`every`) up to {fit.most} gaussians (`most`)": fit.half == 0.25,
        f"at {fit.thinnest} pixels or more (`thinnest`)": fit.weights.normal == 0,
        "stops at a tolerance (1e-4)": Shot.model_fields["temporal"].default.tolerance == 1e-4,
    }
    lower = text.lower()
    for words, holds in said.items():
        assert words.lower() in lower, f"method.md does not say: {words}"
        assert holds, words


# --- figures and benchmarks


def figure(name: str, pattern: str) -> str:
    """A number that a document prints, by a pattern with one group."""
    found = re.search(pattern, " ".join(text_of(name).split()))
    assert found, f"{name} has no figure for {pattern!r}"
    return found.group(1)


CARD, TABLES = "docs/model-card.md", "docs/evaluation-tables.md"
ROW = r" \| [^|]*\| \d+ \| ([\d.]+) ±"
FIGURES = (
    (r"roughness RMSE ([\d.]+) against", CARD, r"RMSE \(best constant\) \| ([\d.]+) \("),
    (r"against ([\d.]+) for the best constant", CARD, r"RMSE \(best constant\) \| [\d.]+ \(([\d.]+)\)"),
    (r"metallic AUC ([\d.]+)", CARD, r"area under the curve \| \| ([\d.]+)"),
    (r"([\d.]+) dB with the model's materials", TABLES, r"\| Full" + ROW),
    (r"([\d.]+) dB with materials that eight cameras", "docs/evidence.md", r"\| 8 cameras \| ([\d.]+) \|"),
    (r"([\d.]+) dB with true materials", TABLES, r"\| Full with true materials" + ROW),
    (r"([\d.]+) dB with the best constant", TABLES, r"\| No Decomposition" + ROW),
)
"""Pattern in the README, the page it links to, pattern there: both must print the same number."""


@pytest.mark.parametrize(("said", "page", "measured"), FIGURES)
def test_readme_prints_the_figures_of_the_pages_it_links_to(said: str, page: str, measured: str) -> None:
    assert f"]({page})" in text_of("README.md")
    places = len(figure("README.md", said).partition(".")[2])
    assert figure("README.md", said) == f"{float(figure(page, measured)):.{places}f}"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_model_card_prints_what_its_command_prints() -> None:
    command = [
        sys.executable,
        str(BENCHMARKS / "decompose_accuracy.py"),
        str(ROOT / "yesnt/data/shot"),
        "--frames",
        "16",
    ]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    roughness, metallic = found["roughness"], found["metallic"]
    rows = {
        "RMSE (best constant)": "{rmse:.3f} ({best_constant:.3f})",
        "Spearman of std and error": "{spearman:.2f}",
        "std over error (root mean squares)": "{std_rms_over_rmse:.2f}",
    }
    for label, form in rows.items():
        assert f"| {label} | {form.format(**roughness)} | {form.format(**metallic)} |" in text_of(CARD)
    assert f"| area under the curve | | {metallic['auc']:.3f} |" in text_of(CARD)


def test_the_model_card_states_the_size_of_the_weights() -> None:
    size = (ROOT / "yesnt/data/weights/embedded.safetensors").stat().st_size
    assert figure(CARD, r"embedded\.safetensors`, ([\d.]+) MB") == f"{size / 1e6:.1f}"


def test_readme_has_no_figure_that_is_not_compared() -> None:
    text = " ".join(text_of("README.md").split())
    compared = {figure("README.md", said) for said, _, _ in FIGURES}
    assert set(re.findall(r"(?<![-\d.])\d+\.\d{1,3}\b", text)) - {"3.11"} <= compared


def benchmarks() -> list[str]:
    """Benchmarks that can be run; what they share is imported by them."""
    return sorted(path.name for path in BENCHMARKS.glob("*.py") if "__main__" in path.read_text())


@pytest.mark.parametrize("name", benchmarks())
def test_every_benchmark_is_named_by_a_document_or_by_make_bench(name: str) -> None:
    bench = re.search(r"^BENCHMARKS := (.*)$", text_of("Makefile"), re.M)
    assert bench
    named = name.removesuffix(".py") in bench.group(1).split()
    assert named or any(name in path.read_text() for path in PAGES), f"no document names {name}"


def test_every_benchmark_imports_what_exists() -> None:
    """Benchmarks are run by hand, so a renamed function would be noticed late."""
    names = [name.removesuffix(".py") for name in benchmarks()]
    code = (
        f"import importlib, sys; sys.path.insert(0, {str(BENCHMARKS)!r}); [importlib.import_module(n) for n in {names}]"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert found.returncode == 0, found.stderr[-2000:]


def test_make_bench_runs_what_exists() -> None:
    bench = re.search(r"^BENCHMARKS := (.*)$", text_of("Makefile"), re.M)
    assert bench
    assert {f"{name}.py" for name in bench.group(1).split()} <= set(benchmarks())


UNIT = re.compile(r"\d(?: ?%|,?\d* (?:dB|GB|MB|s a frame|times faster|times as fast)\b)|\bx0\.\d|\| [*+-]*\d*\.\d+")
COMMAND = re.compile(r"`(?:python|pytest|yesnt (?:eval|trade|demo|plan|stage)|make|tests/)|--[a-z]+ |python tests/")


def sections(page: Path) -> list[tuple[str, str]]:
    """Title and text of each part of a page."""
    parts = re.split(r"^## (.+)$", page.read_text(), flags=re.M)
    return [("", parts[0]), *zip(parts[1::2], parts[2::2], strict=True)]


@pytest.mark.parametrize("page", [p for p in PAGES if p.parent.name == "docs"], ids=lambda p: p.name)
def test_every_section_with_figures_names_the_command_that_prints_them(page: Path) -> None:
    if page.name in ("method.md", "roadmap.md", "evaluation-tables.md"):  # the paper's figures; written by a command
        return
    bare = [title for title, text in sections(page) if UNIT.search(text) and not COMMAND.search(text)]
    assert not bare, f"{page.name}: no command beside the figures of {bare}"


# --- registries that documents rely on


def test_channel_registry_is_whole() -> None:
    assert set(STORED) | set(DELIVERED) | set(SET_LAYERS) | set(ON_REQUEST) == set(CHANNELS)
    for name in (*DELIVERED, *MEASURED, *SET_LAYERS, *ON_REQUEST):
        assert len(CHANNELS[name].exr) == CHANNELS[name].components


def test_no_stage_writes_what_is_not_a_channel() -> None:
    assert {channel for stage in STAGES.values() for channel in stage.channels} == set(STORED)


def test_docs_name_every_knob_of_relighting() -> None:
    from yesnt.relight.settings import RelightSettings

    text = section("docs/relight.md", "Qualities and knobs")
    assert set(re.findall(r"`(\w+)`", text)) >= {field.name for field in dataclasses.fields(RelightSettings)}


def test_backends_page_lists_every_backend_with_its_knobs_and_defaults() -> None:
    from yesnt.decompose.registry import ENTRIES

    rows = dict(re.findall(r"^\| `([a-z-]+)` \|.*\| ([^|]*) \|$", text_of("docs/backends.md"), re.M))
    assert set(rows) == set(ENTRIES)
    for name, entry in ENTRIES.items():
        knobs = {knob: str(spec.default).lower() for knob, spec in entry.knobs.items()}
        assert dict(re.findall(r"(\w+) \((\w*)\)", rows[name])) == knobs, name


def test_stage_page_lists_every_set_of_the_capture_stage() -> None:
    from yesnt.capture_stage.jobs import SETS

    named = set(
        re.findall(r"`([a-z_]+)`", " ".join(re.findall(r"^\| (.*?) \|", section("docs/stage.md", "Sets"), re.M)))
    )
    assert named == set(SETS)
