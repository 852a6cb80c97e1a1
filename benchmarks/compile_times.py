"""What compiling costs: CPU seconds of truth, psf, chip and measure on the demo, compiled code there and not.

    python benchmarks/compile_times.py

The verbs run one after another on one r chip of config/campaign.yaml and a truth brick of it, with a NUMBA_CACHE_DIR
that is empty at the start, so that each compiles what those before it did not need; and again with what is there then.
Then two processes of psf start at once with an empty folder, and `snakemake --cores 2` runs the campaign of `csstsim
init` with another one: without the code that a wheel has, and with it (builders/build_kernels.py). Products of the two
are compared. At toy size the chip is tiny, the code compiled, and snakemake makes its plan only.
"""

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from evidence.record import Record

import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from astropy.io import fits
from support.mini_campaign import write_campaign

from csstsim.base.process.shipped_kernels import VARIABLE
from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).parents[1]
CHIP = 9  # r
PRODUCTS = "results/level0/*/*.fits", "results/**/*.parquet"


def cpu_seconds(
    cache: Path | None,
    *lines: list[str],
    program: str = "csstsim",
    folder: Path | None = None,
    kernels: Path | None = None,
) -> float:
    """Run commands at once; return their CPU seconds.

    cache: folder for compiled code; None: the usual one. kernels: code that comes with csstsim; None: there is none.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = dict(os.environ) | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    environment[VARIABLE] = str(kernels or "")
    if cache:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    started = [subprocess.Popen([program, *line], env=environment, cwd=folder, **quiet) for line in lines]
    for process, line in zip(started, lines, strict=True):
        said = process.communicate()[1]
        if process.returncode:
            sys.exit(f"{program} {' '.join(line)}: exit code {process.returncode}\n{said[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def campaign(folder: Path, toy: bool) -> Path:
    """Return the file of a campaign in a folder: the demo, or one of a tiny chip."""
    folder.mkdir()
    if toy:
        return write_campaign(folder)
    content = load_campaign(ROOT / "config" / "campaign.yaml").model_dump(mode="json") | {"output": str(folder / "out")}
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def calls(file: Path) -> dict[str, list[list[str]]]:
    """Return the words of each verb's calls: as many of truth as the chip has bricks."""
    run = OpenCampaign(file)
    job = next(job for job in run.jobs if job.chip.id == CHIP)
    found = {verb: [[verb, str(file), "--obsid", job.obsid, "--chip", str(CHIP)]] for verb in ("chip", "measure")}
    bricks = [["truth", str(file), "--brick", str(pix)] for pix in run.truth_bricks(job)]
    return {"truth": bricks, "psf": [["psf", str(file), "--chip", str(CHIP)]]} | found


def main(record: Record) -> None:
    """Run each verb with an empty folder of compiled code, and with a full one."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        files = [campaign(folder / name, record.toy) for name in ("first", "again", "one", "two")]
        first, again, one, two = map(calls, files)
        cache, other = (None, None) if record.toy else (folder / "cache", folder / "other")
        rows, total = [], 0.0
        for verb in first:
            compiling, compiled = cpu_seconds(cache, first[verb][0]), cpu_seconds(cache, again[verb][0])
            for line in again[verb][1:]:
                cpu_seconds(cache, line)
            if verb == "truth":  # the same bricks for both, so that chip makes none
                source, target = (OpenCampaign(file).paths.output / "truth" for file in (files[1], files[0]))
                shutil.copytree(source, target, dirs_exist_ok=True)
            total += compiling - compiled
            rows.append([f"`{verb}`", *(f"{cpu:.0f}" for cpu in (compiling, compiled, compiling - compiled))])
            record.value(f"{verb}_first", compiling, f"`csstsim {verb}`, its first run", unit="CPU-s")
            record.value(f"{verb}_again", compiled, f"`csstsim {verb}`, compiled", unit="CPU-s")
        record.value("compiling", total, "compiling, of all four", unit="CPU-s")
        rows.append(["all", "", "", f"{total:.0f}"])
        record.table("verbs", ["verb", "first run, CPU-s", "compiled, CPU-s", "difference"], rows)
        both = cpu_seconds(other, one["psf"][0], two["psf"][0])
        record.value("two_at_once", both, "two first runs of `csstsim psf` at once", unit="CPU-s")
        first_campaigns(record, folder)


def first_campaigns(record: Record, folder: Path) -> None:
    """Run the campaign of `csstsim init` where nothing is compiled, without and with the code that a wheel has."""
    kernels = folder / "kernels"
    if not record.toy:
        words = [str(ROOT / "builders" / "build_kernels.py"), str(kernels)]
        making = cpu_seconds(folder / "unused", words, program=sys.executable)
        record.value("kernels", making, "compiling the code of a wheel", unit="CPU-s")
    text = "the first `snakemake --cores 2` of `csstsim init`, nothing compiled before"
    cases = (
        ("compiled", "first_campaign", None, text, 160),
        ("shipped", "first_campaign_shipped", kernels, f"{text}, from a wheel", 90),
    )
    for name, value, code, what, goal in cases:
        cpu_seconds(None, ["init", str(folder / name)])
        words = ["--cores", "2", *(["--dry-run"] if record.toy else [])]
        cache = None if record.toy else folder / f"cache_{name}"
        cpu = cpu_seconds(cache, words, program="snakemake", folder=folder / name, kernels=code)
        record.value(value, cpu, what, unit="CPU-s", below=goal)
    files = sorted(path for pattern in PRODUCTS for path in (folder / "compiled").glob(pattern))
    differing = [path for path in files if not same(path, folder / "shipped" / path.relative_to(folder / "compiled"))]
    record.value("differing", len(differing), f"of {len(files)} images and tables, those whose bits differ", below=0)


def same(one: Path, other: Path) -> bool:
    """Return whether the data of two FITS files, or of two tables, are the same bits."""
    if one.suffix == ".fits":
        with fits.open(one) as first, fits.open(other) as second:
            return [hdu.header.get("DATASUM") for hdu in first] == [hdu.header.get("DATASUM") for hdu in second]
    return content(one).equals(content(other))


def content(path: Path) -> pa.Buffer:
    """Return the bits of a table in a file, without its metadata and the times that objects took to render."""
    table = pq.read_table(path).replace_schema_metadata(None).combine_chunks()
    table = table.drop_columns(["ms"]) if "ms" in table.column_names else table
    with pa.BufferOutputStream() as sink:
        with pa.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
        return sink.getvalue()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        main(record)
