"""What a campaign would do and cost, before anything runs (`csstsim plan`).

CPU is an estimate from the rates below, measured with benchmarks/stage_costs.py on one core of a 2-core Xeon VM;
it scales with pixels and with the embedded universe's counts of galaxies and stars.
"""

import numpy as np

from csstsim.catalog.astrometry import apparent

CPU_S_PER_OBJECT = {"preview": 1e-4, "standard": 1e-4, "noise_free": 2e-3, "reference": 0.13}
CPU_S_PER_MPIX, CPU_S_PER_MPIX_MEASURED = 0.12, 0.73  # readout and Level-0; measure
CPU_S_PER_MPIX_DISPERSED = 0.5  # photons and slabs through a grating; extraction
CPU_S_PER_STAGE, CPU_S_PER_SELECTION = 2.0, 3.0  # start-up of a process; reading bricks
CPU_S_PER_BRICK = 15.0  # truth
CPU_S_PER_PSF = 0.02  # one node at one wavelength
BYTES_PER_NODE = 4 * (256 * 256 + 256 * 256 + 64 * 64) * 4  # images, and the tables photons are drawn from


def plan(run):
    """Return the plan as {name: number or string}. run: campaign.OpenCampaign."""
    jobs, config, camera = run.jobs, run.config, run.camera
    imaging, science = run.imaging_jobs, run.imaging_jobs + run.slitless_jobs
    pixels, measured = (sum(job.window.nx * job.window.ny for job in part) for part in (jobs, imaging))
    truth = {pix for job in science for pix in run.truth_bricks(job)} if run.embedded else set()
    chips = {job.chip.id for job in jobs if job.pointing.type == "SCIE"}
    nodes = len(chips) * config.psf.grid**2
    objects = _objects(run, science) if run.embedded else None
    detector = camera.detector
    frame = 2 * detector.channels * (detector.channel_nx + detector.prescan + detector.overscan)
    frame *= detector.channel_ny + detector.parallel_overscan
    stages = sum(run.has_stage(job.pointing, s) for job in jobs for s in ("render", "readout", "level0"))
    counts = {
        "exposures": len({job.pointing.obsid for job in jobs}),
        "chips": len({job.chip.id for job in jobs}),
        "Level-0 files": len(jobs),
        "megapixels": round(pixels / 1e6, 1),
        "objects drawn": "as many as the catalogue has" if objects is None else int(float(f"{objects:.2g}")),
        "truth bricks": _listed(truth),
        "bricks touched": len(run.merge_bricks),
        "bricks fully covered": len(_covered(run)),
        "jobs": stages + 2 * len(science) + len(truth) + len(chips) + 2 * len(run.merge_bricks) + bool(science),
    }
    disk = {
        "Level-0": len(jobs) * frame,
        "PSF tables": nodes * BYTES_PER_NODE,
        "largest intermediates (a job)": 8 * max(job.window.nx * job.window.ny for job in jobs),
    }
    cpu = (
        (objects or 0.0) * CPU_S_PER_OBJECT[config.fidelity] + pixels / 1e6 * CPU_S_PER_MPIX
        + measured / 1e6 * CPU_S_PER_MPIX_MEASURED + _spectra_cpu(run)
        + (stages + 2 * len(science)) * CPU_S_PER_STAGE + len(science) * CPU_S_PER_SELECTION
        + len(truth) * CPU_S_PER_BRICK + 4 * nodes * CPU_S_PER_PSF
    )  # fmt: skip
    return counts, disk, cpu


def _spectra_cpu(run):
    """CPU seconds that spectroscopic chips take beside what imaging ones do."""
    return sum(job.window.nx * job.window.ny for job in run.slitless_jobs) / 1e6 * CPU_S_PER_MPIX_DISPERSED


def _listed(bricks):
    """How many, and which if they are few: `csstsim truth --brick` asks for a number."""
    return f"{len(bricks)}: {', '.join(map(str, sorted(bricks)))}" if 0 < len(bricks) <= 8 else len(bricks)


def _objects(run, jobs):
    """Expected galaxies and stars on the windows of jobs: i and V counts down to the campaign's limit."""
    from csstsim.universe.galaxies import cumulative_counts
    from csstsim.universe.stars import expected_counts

    numbers, limit = run.universe.numbers, run.config.catalog.mag_limit
    mag, galaxies = cumulative_counts(numbers["galaxies"])
    galaxies = galaxies[-1] if limit is None else np.interp(limit, mag, galaxies)
    faint = numbers["stars"]["limits"][1]
    pointings = {job.pointing.obsid: (job.pointing.ra, job.pointing.dec) for job in jobs}
    places = np.transpose(list(pointings.values()))
    stars = expected_counts(*places, numbers["stars"], min(limit or faint, faint)) if pointings else []
    density = {obsid: galaxies + count for obsid, count in zip(pointings, stars, strict=True)}  # deg-2
    pixel = (run.camera.telescope.pixel_scale / 3600.0) ** 2
    return sum(job.window.nx * job.window.ny * pixel * density[job.pointing.obsid] for job in jobs)


def _covered(run):
    """Bricks of which every point sampled is on a measured window, in some exposure."""
    import healpy

    covered = []
    for pix, jobs in run.merge_bricks.items():
        ra, dec = healpy.pix2ang(256 * 32, np.arange(pix * 1024, (pix + 1) * 1024), nest=True, lonlat=True)
        seen = np.zeros(len(ra), bool)
        for job in jobs:
            x, y = job.wcs.world_to_pixel(*apparent(ra, dec, job.observer))
            seen |= job.window.contains(x, y)
        if seen.all():
            covered.append(pix)
    return covered


def print_plan(run):
    """Print the plan of an open campaign."""
    from rich.console import Console
    from rich.table import Table

    counts, disk, cpu = plan(run)
    table = Table(title=f"{run.config.name} ({run.file})", show_header=False)
    for name, value in counts.items():
        table.add_row(name, value if isinstance(value, str) else f"{value:,}")
    for name, value in disk.items():
        table.add_row(f"disk: {name}", f"{value / 1e9:,.2f} GB")
    table.add_row("CPU, an estimate", f"{cpu / 3600:,.2f} h")
    Console().print(table)
