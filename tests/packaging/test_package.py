"""The wheel and the source distribution, built as a user builds them; the wheel's page for a package index."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile

import pytest

from csstsim import __version__
from csstsim.base.commit import NOTE, commit_of
from csstsim.base.shipped import ROOT

pytestmark = pytest.mark.thorough
PIP = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", "--wheel-dir"]
SDIST = "from hatchling.build import build_sdist; import sys; print(build_sdist(sys.argv[1]))"


@pytest.fixture(scope="module")
def with_kernels(tmp_path_factory):
    """The environment of a build with compiled code."""
    kernels = tmp_path_factory.mktemp("kernels")
    (kernels / "about.json").write_text("{}")
    return os.environ | {"CSSTSIM_KERNELS": str(kernels)}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory, with_kernels):
    """The wheel of the clone."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run([*PIP, folder, ROOT], env=with_kernels, check=True)
    [path] = folder.glob("*.whl")
    return path


def test_the_wheel_has_the_version_and_the_commit(wheel):
    assert wheel.name == f"csstsim-{__version__}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as file:
        assert file.read(f"csstsim/_shipped/{NOTE}").decode().strip() == commit_of(ROOT)
        names = file.namelist()
        assert file.read("csstsim/_kernels/about.json") == b"{}"
    assert f"csstsim-{__version__}.dist-info/licenses/LICENSE" in names
    assert {name.split("/")[0] for name in names} == {
        "csstsim", "snakemake_logger_plugin_csstsim", f"csstsim-{__version__}.dist-info",
    }  # fmt: skip


def test_links_and_images_of_the_page_are_files_of_the_tag(wheel):
    with zipfile.ZipFile(wheel) as file:
        page = file.read(f"csstsim-{__version__}.dist-info/METADATA").decode().split("\n\n", 1)[1]
    source = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]["Source"]
    links = re.findall(r"(!?)\[[^\]]*\]\(([^)]*)\)", page)
    assert all(address.startswith("https://") for _, address in links)
    ours = [(image, address.removeprefix(source)) for image, address in links if address.startswith(source)]
    assert len(ours) > 40 and sum(image == "!" for image, _ in ours) >= 3
    for image, path in ours:
        start = f"/{'raw' if image else 'blob'}/v{__version__}/"
        assert path.startswith(start) and (ROOT / path.removeprefix(start).split("#")[0]).exists(), path


def test_a_wheel_of_the_source_distribution_is_that_of_the_clone(wheel, with_kernels, tmp_path):
    """Also without git, so with the commit that the source distribution notes."""
    subprocess.run([*PIP, tmp_path / "tools", "hatchling"], check=True)
    tools = [str(path) for path in (tmp_path / "tools").glob("*.whl")]
    subprocess.run([sys.executable, "-m", "pip", "install", "-q", "--target", tmp_path / "site", *tools], check=True)
    run = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(tmp_path / 'site')!r}); {SDIST}", tmp_path]
    subprocess.run(run, cwd=ROOT, check=True)
    [source] = tmp_path.glob("*.tar.gz")
    with tarfile.open(source) as file:
        file.extractall(tmp_path / "open", filter="data")
    [folder] = (tmp_path / "open").iterdir()
    assert folder.name == f"csstsim-{__version__}" and commit_of(folder) == commit_of(ROOT)
    subprocess.run([*PIP, tmp_path / "again", folder], env=with_kernels, check=True)
    [again] = (tmp_path / "again").glob("*.whl")
    with zipfile.ZipFile(wheel) as one, zipfile.ZipFile(again) as two:
        assert {name: one.getinfo(name).CRC for name in one.namelist()} == {
            name: two.getinfo(name).CRC for name in two.namelist()
        }
