# What a campaign makes in all, and what is said of it at the end.
def targets():
    """Every product but truth bricks and PSF sets, so that what is removed from a finished campaign is made again.

    Of those two what the chips still need is made: a new one is newer than all chips, which would be made again with it.
    """
    found = level0_files() + [
        str(RUN.paths.level0_truth(job.pointing, job.chip.id)) for job in RUN.jobs
    ]
    for job in RUN.slitless_jobs:
        table = RUN.paths.spectra(*job.key)
        orders = RUN.paths.level0_orders(job.pointing, job.chip.id)
        found += [str(orders), str(table), str(table.with_suffix(".png"))]
    found += [str(RUN.paths.measure(*job.key)) for job in RUN.imaging_jobs]
    for pix in RUN.merge_bricks:
        verdict = RUN.paths.validate(pix)
        found += [
            str(RUN.paths.merge(pix)),
            str(verdict),
            str(verdict.with_suffix(".png")),
        ]
    if RUN.imaging_jobs or RUN.slitless_jobs:
        page = RUN.paths.report
        found += [str(page), str(page.with_name("verdict.json")), *catalogue()]
    found += [str(RUN.paths.masters(chip)) for chip in RUN.calibration_jobs]
    if RUN.config.measurement.keep_calibrated:
        found += [str(RUN.paths.calibrated(*job.key)) for job in RUN.imaging_jobs]
    return found


def summary():
    """What the campaign made and where to look, said when it is done."""
    truth = " with their truth" if "SCIE" in RUN.steps else ""
    lines = [
        f"\n{RUN.config.name}: {len(RUN.jobs)} Level-0 files{truth} in {OUT}/level0/"
    ]
    if RUN.calibration_jobs:
        lines.append(f"masters of {len(RUN.calibration_jobs)} chips in {OUT}/masters/")
    if RUN.config.measurement.keep_calibrated:
        lines.append(
            f"calibrated images of {len(RUN.imaging_jobs)} chips in {OUT}/calibrated/"
        )
    if RUN.imaging_jobs:
        lines.append(
            f"merged catalogues of {len(RUN.merge_bricks)} bricks in {OUT}/merge/"
        )
    if RUN.slitless_jobs:
        lines.append(f"spectra of {len(RUN.slitless_jobs)} chips in {OUT}/spectra/")
    if RUN.imaging_jobs or RUN.slitless_jobs:
        lines.append(f"open the report: {RUN.paths.report.resolve().as_uri()}")
    return "\n".join(lines)
