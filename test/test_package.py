"""package.xml, setup.py, the lock file and the code say the same."""

from __future__ import annotations

import ast
import re
import sys
from email.utils import parseaddr
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest
import setuptools  # noqa: F401  (provides distutils from Python 3.12 on)
from catkin_pkg.package import Package, parse_package
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parent.parent

# Import name -> (name at PyPI, rosdep key). What rosbags brings has no key of its own.
PYTHON_PACKAGES = {
    "apsw": ("apsw", "python3-rosbags-pip"),
    "backports": ("backports.zstd", "python3-rosbags-pip"),
    "coal": ("coal", "coal"),
    "cv2": ("opencv-python-headless", "python3-opencv"),
    "lz4": ("lz4", "python3-rosbags-pip"),
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "mpl_toolkits": ("matplotlib", "python3-matplotlib"),
    "mujoco": ("mujoco", "python3-mujoco-pip"),
    "numba": ("numba", "python3-numba"),
    "numpy": ("numpy", "python3-numpy"),
    "ompl": ("ompl", "ompl"),
    "pinocchio": ("pin", "pinocchio"),
    "rich": ("rich", "python3-rich"),
    "rosbags": ("rosbags", "python3-rosbags-pip"),
    "scipy": ("scipy", "python3-scipy"),
    "threadpoolctl": ("threadpoolctl", "python3-threadpoolctl"),
    "typer": ("typer", "python3-typer"),
    "yaml": ("PyYAML", "python3-yaml"),
}
# Loaded by name at run time, so that no import tells of it.
NOT_IMPORTED = {"rmw_fastrtps_cpp"}


@pytest.fixture(scope="module")
def manifest() -> Package:
    return parse_package(REPOSITORY)


@pytest.fixture
def setup_script(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What setup.py passes to setuptools."""
    from distutils.core import run_setup

    monkeypatch.chdir(REPOSITORY)
    return run_setup("setup.py", stop_after="init")


def locked() -> dict[str, str]:
    """Version of each package in the lock file, by its canonical name."""
    lines = (REPOSITORY / "requirements.lock").read_text("utf-8").splitlines()
    pins = [line.split(";")[0].strip() for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(pin.split("==")[0]): pin.split("==")[1] for pin in pins}


def imported_by_the_package() -> set[str]:
    """Top-level names of others that the package and its launch files import."""
    files = [*REPOSITORY.glob("infomap_ros/**/*.py"), *REPOSITORY.glob("launch/*.py")]
    names = set()
    for path in files:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add((node.module or "").split(".")[0])
    return names - set(sys.stdlib_module_names) - {"infomap_ros"}


def named_message_packages() -> set[str]:
    """Message packages that the code names as text, such as ``"sensor_msgs/msg/Image"``."""
    text = "".join(path.read_text("utf-8") for path in REPOSITORY.glob("infomap_ros/**/*.py"))
    return set(re.findall(r"\b([a-z0-9_]+)/(?:msg|srv|action)/[A-Z]", text))


def test_manifest_is_valid(manifest: Package) -> None:
    warnings: list[str] = []
    manifest.validate(warnings=warnings)
    assert warnings == []
    assert manifest.package_format == 3
    assert manifest.get_build_type() == "ament_python"


def test_name_version_license_and_maintainer_agree(manifest: Package, setup_script: Any) -> None:
    metadata = setup_script.metadata
    assert manifest.name == metadata.name == "infomap_ros"
    assert manifest.version == metadata.version
    assert manifest.licenses == [metadata.license] == ["Apache-2.0"]
    assert [(person.name, person.email) for person in manifest.maintainers] == [
        (metadata.maintainer, metadata.maintainer_email)
    ]
    assert parseaddr(metadata.maintainer_email)[1] == metadata.maintainer_email


def test_license_text_is_the_one_named() -> None:
    text = (REPOSITORY / "LICENSE").read_text("utf-8")
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text


def test_installed_package_has_the_version_of_the_manifest(manifest: Package) -> None:
    assert distribution("infomap_ros").version == manifest.version


def test_changelog_knows_the_version(manifest: Package) -> None:
    text = (REPOSITORY / "CHANGELOG.rst").read_text("utf-8")
    newest = re.search(r"^(Forthcoming|[0-9.]+)(?: \(\d{4}-\d\d-\d\d\))?\n-+$", text, re.MULTILINE)
    assert newest is not None
    assert newest[1] in (manifest.version, "Forthcoming")


def test_entry_points_name_functions_that_exist(setup_script: Any) -> None:
    for script in setup_script.entry_points["console_scripts"]:
        _, module, function = re.split(r" = |:", script)
        path = REPOSITORY.joinpath(*module.split("."))
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        tree = ast.parse(file.read_text("utf-8"))
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_every_file_of_the_share_folders_is_installed(setup_script: Any) -> None:
    installed = {source: target for target, files in setup_script.data_files for source in files}
    for folder in ("config", "launch", "bags"):
        for path in (REPOSITORY / folder).rglob("*"):
            hidden = "__pycache__" in path.parts or path.name.startswith(".")
            if path.is_file() and not hidden:
                source = path.relative_to(REPOSITORY)
                assert installed.get(str(source)) == f"share/infomap_ros/{source.parent}"
    assert installed["package.xml"] == "share/infomap_ros"
    marker = REPOSITORY / "resource" / "infomap_ros"
    assert marker.is_file()
    assert installed["resource/infomap_ros"].endswith("ament_index/resource_index/packages")


def test_every_file_beside_the_code_is_installed(setup_script: Any) -> None:
    package = REPOSITORY / "infomap_ros"
    patterns = setup_script.package_data["infomap_ros"]
    installed = {path for pattern in patterns for path in package.glob(pattern)}
    files = {path for path in package.rglob("*") if path.is_file()}
    others = {p for p in files if p.suffix != ".py" and "__pycache__" not in p.parts}
    assert others == installed


def test_every_import_is_a_dependency(manifest: Package, setup_script: Any) -> None:
    keys = {dependency.name for dependency in manifest.exec_depends}
    required = {Requirement(text).name for text in setup_script.install_requires}
    for name in imported_by_the_package():
        if name in PYTHON_PACKAGES:
            package, key = PYTHON_PACKAGES[name]
            assert package in required
            assert key in keys
        else:
            assert name in keys
    assert named_message_packages() <= keys


def test_every_dependency_is_imported(manifest: Package, setup_script: Any) -> None:
    used = imported_by_the_package() | named_message_packages()
    known = [PYTHON_PACKAGES[name] for name in used if name in PYTHON_PACKAGES]
    keys = {dependency.name for dependency in manifest.exec_depends} - NOT_IMPORTED
    assert keys - used - {key for _, key in known} == set()
    required = {Requirement(text).name for text in setup_script.install_requires}
    assert required == {package for package, _ in known}


def test_lock_holds_every_requirement_within_its_range(setup_script: Any) -> None:
    pins = locked()
    extras = [text for texts in setup_script.extras_require.values() for text in texts]
    for text in (*setup_script.install_requires, *extras):
        requirement = Requirement(text)
        assert requirement.specifier.contains(pins[canonicalize_name(requirement.name)])


def test_lock_is_made_of_all_extras_but_the_large_ones(setup_script: Any) -> None:
    makefile = (REPOSITORY / "Makefile").read_text("utf-8")
    named = re.search(r"^EXTRAS := (.*)$", makefile, re.MULTILINE)
    assert named is not None
    assert set(named[1].split()) == setup_script.extras_require.keys()


def test_lock_holds_what_its_packages_require() -> None:
    pins = locked()
    for name in pins:
        for text in distribution(name).requires or ():
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                version = pins.get(canonicalize_name(requirement.name))
                assert version is not None, f"{name} requires {text}"
                assert requirement.specifier.contains(version, prereleases=True)


def test_lock_names_no_place() -> None:
    text = (REPOSITORY / "requirements.lock").read_text("utf-8")
    assert not re.search(r"://|^-|@|/", text, flags=re.MULTILINE)


def test_environment_is_the_locked_one() -> None:
    differing = {
        name: (distribution(name).version, version)
        for name, version in locked().items()
        if Requirement(f"x=={version}").specifier.contains(distribution(name).version) is False
    }
    assert differing == {}
