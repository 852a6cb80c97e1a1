"""A tiny Survey Camera for tests: the shipped filters, telescope and layout around a 256 x 64 pixel detector."""

import shutil
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import yaml

INSTRUMENT = Path(__file__).resolve().parents[2] / "config" / "instrument"
GEOMETRY = {
    "nx": 256,
    "ny": 64,
    "channels_x": 8,
    "channels_y": 2,
    "channel_nx": 32,
    "channel_ny": 32,
    "prescan": 3,
    "overscan": 7,
    "parallel_overscan": 4,
}


def mini_camera(tmp_path, **geometry):
    """Write an instrument folder `tmp_path`/instrument and return its path.

    16 channels of 32 x 32 active pixels unless `geometry` says otherwise; chip centres shrink with the chip's sides,
    the optics' distortion (distortion.yaml, not the model fitted to it) with the width, so that its slopes stay; so do
    spectra; the pixel scale, filters and every other file are the shipped ones.
    """
    made = _made(tuple((GEOMETRY | geometry).items()))
    return shutil.copytree(made, Path(tmp_path) / "instrument", dirs_exist_ok=True, copy_function=shutil.copyfile)


@cache
def _kept():
    return tempfile.TemporaryDirectory(prefix="mini_camera_")


@cache
def _made(geometry):
    """Return the folder of a geometry, made once in a process, to be copied."""
    folder, wanted = Path(tempfile.mkdtemp(dir=_kept().name)), dict(geometry)
    for source in INSTRUMENT.rglob("*"):
        if source.is_file():
            target = folder / source.relative_to(INSTRUMENT)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(source.read_bytes())
    _edit(folder / "detector.yaml", lambda data: data["geometry"].update(wanted))
    shape = yaml.safe_load((INSTRUMENT / "detector.yaml").read_text(encoding="utf-8"))["geometry"]

    def shrink(data):
        for chip in data["chips"]["values"]:
            chip["xc"] *= wanted["nx"] / shape["nx"]
            chip["yc"] *= wanted["ny"] / shape["ny"]

    _edit(folder / "chips.yaml", shrink)

    def shrink_optics(data):
        data["radius"]["value"] *= wanted["nx"] / shape["nx"]
        for name, px in data["optics"].items():
            if name in ("cubic", "quintic", "decentring", "astigmatic"):
                data["optics"][name] = (np.array(px) * wanted["nx"] / shape["nx"]).tolist()

    _edit(folder / "distortion.yaml", shrink_optics)
    scale = [wanted[name] / shape[name] for name in ("nx", "ny")]

    def shrink_gratings(data):
        for row in data["chips"]["values"].values():
            row["split"] = max(int(row["split"] * scale[0]), 1)
            row["reach"] = [round(v * s, 3) for v, s in zip(row["reach"], np.repeat(scale, 2).tolist(), strict=True)]

    _edit(folder / "gratings.yaml", shrink_gratings)
    for path in (folder / "gratings").glob("*.conf"):
        path.write_text("\n".join(_shrunk(line, *scale) for line in path.read_text().splitlines()) + "\n")
    return folder


def _shrunk(line, x, y):
    """Return a line of an aXe configuration for a chip smaller by x along rows and y along columns."""
    key, *values = line.split() or [""]
    length = {"BEAM": x, "XOFF": x, "YOFF": x, "DLDP": 1.0, "DYDX": 1.0}.get(key[:4])
    if length is None or "ORDER" in key:
        return line
    if key.startswith(("DLDP", "DYDX")):
        length = {("DYDX", "0"): x, ("DLDP", "1"): 1 / x}.get((key[:4], key[-1]), 1.0)
    terms = 1.0 / np.array([1.0, x, y, x * x, x * y, y * y])
    scaled = np.array(values, float) * length * (1.0 if key.startswith("BEAM") else terms[: len(values)])
    return " ".join([key, *(f"{v:.9g}" for v in scaled)])


def _edit(path, change):
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
