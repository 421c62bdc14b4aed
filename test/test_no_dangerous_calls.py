"""Nothing in the package runs, or unpickles, what a file or a message says."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import infomap_ros

ROOT = Path(infomap_ros.__file__).parent
MODULES = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "marshal", "shelve", "joblib"}
CALLS = {"eval", "exec", "compile", "__import__"}  # where they are the builtins
METHODS = {
    ("os", "system"),
    ("os", "popen"),
    ("subprocess", "getoutput"),
    ("subprocess", "getstatusoutput"),
    ("tempfile", "mktemp"),
    ("yaml", "load"),
    ("yaml", "load_all"),
    ("yaml", "unsafe_load"),
    ("yaml", "full_load"),
}


def faults(source: str) -> list[str]:
    """What a source text has that it must not have, with the lines."""
    found: list[str] = []
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
            names += [f"{node.module}.{alias.name}" for alias in node.names]
            pairs = {".".join(pair) for pair in METHODS}
            found += [f"{node.lineno}: {name}" for name in names if name in pairs]
        found += [f"{node.lineno}: {n}" for n in names if n.partition(".")[0] in MODULES]
        if isinstance(node, ast.Call):
            found += [f"{node.lineno}: {fault}" for fault in _call_faults(node)]
    return found


def _call_faults(call: ast.Call) -> list[str]:
    function, options = call.func, {word.arg: word.value for word in call.keywords}
    found = [name for name in ("shell", "allow_pickle") if _may_be_true(options.get(name))]
    if isinstance(function, ast.Name) and function.id in CALLS:
        found.append(function.id)
    if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name):
        place = function.value.id, function.attr
        if place in METHODS:
            found.append(".".join(place))
    return found


def _may_be_true(value: ast.expr | None) -> bool:
    return value is not None and not (isinstance(value, ast.Constant) and value.value is False)


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("import pickle", 1),
        ("from pickle import loads", 2),
        ("eval('1')", 1),
        ("model.eval()", 0),
        ("re.compile('a')", 0),
        ("yaml.load(text)", 1),
        ("from yaml import load", 1),
        ("yaml.safe_load(text)", 0),
        ("subprocess.run(['ls'])", 0),
        ("subprocess.run('ls', shell=given)", 1),
        ("np.load(f, allow_pickle=True)", 1),
        ("np.load(f, allow_pickle=False)", 0),
        ("os.system('ls')", 1),
    ],
)
def test_what_is_looked_for_is_found(source: str, count: int) -> None:
    assert len(faults(source)) == count


def test_no_module_runs_what_it_reads() -> None:
    files = sorted(ROOT.rglob("*.py"))
    assert len(files) > 300
    found = {str(file.relative_to(ROOT)): faults(file.read_text("utf-8")) for file in files}
    assert {name: lines for name, lines in found.items() if lines} == {}
