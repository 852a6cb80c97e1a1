"""Cost of a finished campaign per file, and of Cycle 9 and 17,500 square degrees by the same numbers.

    python benchmarks/projection.py [CAMPAIGN] [--cpu S] [--lost S]        default: examples/release.yaml

The numbers are from the campaign's logs and the sizes of its products. `--cpu`: all CPU seconds spent on it, `--lost`:
those of them of what was killed (benchmarks/release.py prints both). Parts that the next attempt took over are not
lost. What is left beside the jobs' is Snakemake's, with the start and end of processes. The campaign needs whole chips:
cut-outs cost too little. The caveats are printed with the numbers.
"""

import argparse
import math
import subprocess
import sys
from pathlib import Path

from evidence.record import Record

from toy_campaign import made_frames

from csstsim.base.errors import CsstsimError
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.running.job_log import earlier_parts, parts, read_usage

ROOT = Path(__file__).parents[1]
MAKING = ("select", "render", "readout", "level0", "chip")  # rules that make a Level-0 file
TOGETHER = {"exposure": "chip", "measure_exposure": "measure", "extract_exposure": "extract"}  # an exposure's chips
FIELDS, SHAPES, CHIPS = 5, 2, 30  # Cycle 9: W1 to W5, galaxies as they are and turned by 90 deg
FILES, PAPER = 73_260, 300_000  # Cycle 9, CPU hours of the paper, section 6.2
AREA, VISITS = 17_500, 2  # deg2; exposures of each position in each of u, g, r, i, z


def spent(output):
    """Return {rule: [(name of the job, JobUsage, {chip or brick: CPU s} of its parts, those of earlier attempts)]}."""
    found = {}
    for path in sorted((output / "logs").glob("*/*.log")):
        text = path.read_text(errors="replace")
        if said := read_usage(text):
            found.setdefault(path.parent.name, []).append((path.stem, said, parts(text), earlier_parts(text)))
    return found


def each_product(jobs):
    """Return {rule: [(name, CPU s)]}, one for each chip or brick, whatever one process made. jobs: what `spent` says.

    Names end in the chip's number. What a process takes beside its parts is shared out among them.
    """
    found = {}
    for rule, rows in jobs.items():
        for name, said, of_parts, earlier in rows:
            beside = (said.cpu_s - sum(of_parts.values())) / max(len(of_parts | earlier), 1)
            several = [(f"{number:02d}", cpu + beside) for number, cpu in (of_parts | earlier).items()]
            found.setdefault(TOGETHER.get(rule, rule), []).extend(several or [(name, said.cpu_s)])
    return found


def sizes(folder):
    """Return {kind: (files, bytes)} of a campaign's output; a kind is a folder, or in level0 a kind of file."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_file():
            kind = path.relative_to(folder).parts[0]
            if kind == "level0":
                kind = f"level0 {''.join(path.suffixes)}"
            files, size = found.get(kind, (0, 0))
            found[kind] = files + 1, size + path.stat().st_size
    return found


def per_file(run, made):
    """Return {'imaging': CPU s per Level-0 file, 'spectroscopic': ...}; None if there is no such file.

    made: what `each_product` says.
    """
    dispersed = {f"{job.chip.id:02d}" for job in run.slitless_jobs}
    total = {True: 0.0, False: 0.0}
    for rule in MAKING:
        for name, cpu in made.get(rule, []):
            total[name[-2:] in dispersed] += cpu
    count = {True: len(run.slitless_jobs), False: len(run.jobs) - len(run.slitless_jobs)}
    return {word: total[key] / count[key] if count[key] else None for key, word in
            ((False, "imaging"), (True, "spectroscopic"))}  # fmt: skip


def record_jobs(jobs, record):
    """Record the jobs by rule."""
    lines = []
    for rule, rows in jobs.items():
        wall, cpu, memory = zip(*[(said.wall_s, said.cpu_s, said.memory_mb) for _, said, *_ in rows], strict=True)
        n = len(rows)
        times = sum(wall) / n, max(wall), sum(cpu) / n, max(cpu)
        lines.append([f"`{rule}`", n, *(f"{v:.1f}" for v in times), f"{max(memory):.0f}"])
    words = ("wall s, mean", "maximum", "CPU-s, mean", "maximum", "resident MB, maximum")
    header = ["rule", "jobs", *words]
    record.table("jobs", header, lines)
    record.value("memory_gb", max(said.memory_mb for rows in jobs.values() for _, said, *_ in rows) / 1e3,
                 "largest resident memory of a job", unit="GB")  # fmt: skip


def record_filters(run, made, record):
    """Record the CPU s of a chip by its filter; made: what `each_product` says."""
    filters = {f"{chip.id:02d}": chip.filter for chip in run.camera.chips.values()}
    lines = []
    for name in run.camera.filters:
        cells = []
        for rules in (MAKING, ("measure", "extract")):
            cpu = [cpu for rule in rules for chip, cpu in made.get(rule, []) if filters[chip[-2:]] == name]
            files = len([job for job in run.jobs if job.chip.filter == name])
            cells.append(f"{sum(cpu) / files:.1f}" if cpu else "-")
        if cells != ["-", "-"]:
            lines.append([name, *cells])
    record.table("filters", ["filter", "catalogue to Level-0 file, CPU-s", "`measure` or `extract`, CPU-s"], lines)


def record_cycle9(run, made, beside, lost, record):
    """Record Cycle 9 by this campaign's means (`each_product`); beside, lost: CPU s per file, or None."""
    mean = {rule: sum(cpu for _, cpu in rows) / len(rows) for rule, rows in made.items()}
    spectra = FILES * len(run.camera.slitless_chips) // CHIPS
    fields = [run] if record.toy else [OpenCampaign(ROOT / f"config/c9_w{n}.yaml") for n in range(1, FIELDS + 1)]
    truth = sum(len({pix for job in field.jobs for pix in field.truth_bricks(job)}) for field in fields)
    merged = SHAPES * sum(len(field.merge_bricks) for field in fields)
    level0 = per_file(run, made)
    rows = [
        ("Level-0 and truth, imaging", FILES - spectra, level0["imaging"]),
        ("Level-0 and truth, spectroscopic", spectra, level0["spectroscopic"]),
        ("truth bricks", truth, mean.get("truth")), ("PSF sets", CHIPS, mean.get("psf")),
        ("measure", FILES - spectra, mean.get("measure")), ("extract", spectra, mean.get("extract")),
        ("merge, validate", merged, mean.get("merge", 0) + mean.get("validate", 0)),
        ("Snakemake, start and end of processes", FILES, beside), ("lost by kills", FILES, lost),
    ]  # fmt: skip
    total, lines = 0.0, []
    for name, number, cpu in rows:
        total += number * (cpu or 0.0) / 3600
        hours = number * (cpu or 0) / 3600
        lines.append([name, f"{number:,}", "-" if cpu is None else f"{cpu:.1f}", f"{hours:,.0f}"])
    level0 = sum(number * (cpu or 0) for _, number, cpu in rows[:2]) / 3600
    lines.append(["all", f"{FILES:,}", f"{3600 * total / FILES:.1f}", f"{total:,.0f}"])
    lines.append(["the paper", f"{FILES:,}", f"{3600 * PAPER / FILES:,.0f}", f"{PAPER:,}"])
    record.table("cycle9", ["Cycle 9", "number", "CPU-s each", "CPU hours"], lines)
    seen = ", ".join(sorted({job.obsid for job in run.jobs}))
    record.value("cycle9_hours", total, "Cycle 9 with everything", unit="CPU hours")
    record.value("cycle9_level0_hours", level0, "Cycle 9, Level-0 files alone", unit="CPU hours")
    record.value("cpu_a_file", 3600 * total / FILES, "CPU time a file, with everything", unit="CPU-s")
    record.value("level0_cpu", 3600 * level0 / FILES, "CPU time a file, Level-0 and truth", unit="CPU-s")
    record.value("fewer", PAPER / total, "the paper's CPU hours over ours, with everything")
    record.value("fewer_level0", PAPER / level0, "the paper's CPU hours over ours, Level-0 files alone")
    print("The paper does not say what its hours include, nor on which cores; neither has a pipeline's calibration.")
    print(f"csstsim's are from {len(run.jobs)} files of {seen}; some fields have more stars.")
    return total * 3600 / FILES


def record_survey(run, found, cpu, record):
    """Record a projection to 17,500 square degrees from this campaign's bytes, files and CPU s per Level-0 file."""
    chip = run.camera.detector.nx * run.camera.detector.ny * (run.camera.telescope.pixel_scale / 3600) ** 2
    exposures = math.ceil(AREA * VISITS / (2 * chip))  # two chips a filter
    files, area = exposures * CHIPS, 4 * 180**2 / math.pi / (12 * 256**2)
    kept = {
        kind: pair
        for kind, pair in found.items()
        if kind not in ("truth", "psf", "report", "chips") and "." not in kind.split()[0]
    }
    lines = [["exposures", f"{exposures:,}"], ["Level-0 files", f"{files / 1e6:.1f} million"],
             ["bricks", f"{AREA / area:,.0f}"]]  # fmt: skip
    for kind, (number, size) in kept.items():
        share = files / len(run.jobs)
        lines.append([kind, f"{size * share / 1e12:,.1f} TB, {number * share / 1e6:.1f} million files"])
    truth = found.get("truth", (1, 0))
    lines.append(["truth bricks", f"{truth[1] / truth[0] * AREA / area / 1e12:,.1f} TB"])
    lines.append(["CPU hours", f"{files * cpu / 3600 / 1e6:.2f} million"])
    record.table("survey", [f"{AREA:,} deg2, {VISITS} visits a filter", ""], lines)


def project(run: OpenCampaign, cpu: float | None, lost: float, record: Record) -> None:
    """Record the cost of a finished campaign, and what it means for surveys. cpu, lost: as the options of this script.

    Ends the program if the campaign has no logs.
    """
    jobs = spent(run.paths.output)
    made = each_product(jobs)
    if not made.keys() & set(MAKING):
        sys.exit(f"{run.paths.output}: no logs of Level-0 files; run the campaign first")
    known = sum(said.cpu_s for rows in jobs.values() for _, said, *_ in rows)
    kept = sum(sum(earlier.values()) for rows in jobs.values() for *_, earlier in rows)  # by what was killed
    record_jobs(jobs, record)
    record_filters(run, made, record)
    beside = lost_each = None
    if cpu is not None:
        lost_each = (lost - kept) / len(run.jobs)
        beside = (cpu - lost - known) / len(run.jobs)
    record_survey(run, sizes(run.paths.output), record_cycle9(run, made, beside, lost_each, record), record)


def main() -> None:
    """Project a campaign that is finished."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default=str(ROOT / "examples" / "release.yaml"))
    parser.add_argument("--cpu", type=float, help="all CPU seconds spent on the campaign")
    parser.add_argument("--lost", type=float, default=0.0, help="CPU seconds of them, of what was killed")
    with Record(parser) as record:
        try:
            run = toy_campaign(record.results) if record.toy else OpenCampaign(record.options.campaign)
        except CsstsimError as error:
            sys.exit(str(error))
        project(run, record.options.cpu, record.options.lost, record)


def toy_campaign(results: Path) -> OpenCampaign:
    """Return a campaign of one tiny chip, which has a log as a job of Snakemake writes it."""
    file, run = made_frames(results / "projection", select={"types": ["SCIE"], "chips": [9]})
    job = run.jobs[0]
    log = run.paths.output / "logs" / "chip" / f"{job.obsid}_09.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    words = [Path(sys.executable).with_name("csstsim"), "chip", file, "--obsid", job.obsid, "--chip", "9"]
    with open(log, "w") as output:
        subprocess.run([str(word) for word in words], stdout=output, check=True)
    return run


if __name__ == "__main__":
    main()
