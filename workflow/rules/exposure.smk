# All chips of an exposure in one process, at choice: `--config chips=exposure`. A process sees (exec) if Snakemake was killed. Where a region is selected, exposures have
# different chips: a rule for each set of chips. A chip that failed among others has a rule of its own.
DISPERSED = by_exposure(RUN.slitless_jobs)


def level0_endings(obsid, chip):
    orders = ["orders.parquet"] * (chip in DISPERSED.get(obsid, ()))
    text = ["cat"] * ("cat" in RUN.config.truth)
    return "fits", "truth.parquet", *text, *orders


for number, chips_of, files, obsids, alone in groups_alike(
    RUN.jobs, "level0", level0_endings
):

    rule:
        name:
            f"exposure_{number}"
        input:
            of_exposure(unless_equal("level0", truth_of, psf_of), chips_of),
        output:
            [
                f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{chip}_{ENDING}.{end}"
                for chip, ends in files
                for end in ends
            ],
        log:
            f"{OUT}/logs/exposure/{{name}}_{{obsid}}{alone}.log",
        wildcard_constraints:
            obsid="|".join(obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            # Twice what a chip takes, and more where one part of it may be long
            runtime=more(4 + max(SELECTING, RENDERING) * len(files)),
        params:
            recipe=recipes_of("level0", chips_of),
            chips=options_of(files),
        shell:
            "exec csstsim chip {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"


for number, chips_of, files, obsids, alone in groups_alike(
    RUN.imaging_jobs, "measure", lambda *_: (".parquet",)
):

    rule:
        name:
            f"measure_exposure_{number}"
        input:
            of_exposure(unless_equal("measure", level0_of, measured_with), chips_of),
        output:
            [
                f"{OUT}/measure/{{obsid}}_{chip}{end}"
                for chip, ends in files
                for end in ends
            ],
        log:
            f"{OUT}/logs/measure_exposure/{{obsid}}{alone}.log",
        wildcard_constraints:
            obsid="|".join(obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            runtime=more(2 + 2 * len(files)),
        params:
            recipe=recipes_of("measure", chips_of),
            chips=options_of(files),
        shell:
            "exec csstsim measure {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"


for number, chips_of, files, obsids, alone in groups_alike(
    RUN.slitless_jobs, "extract", lambda *_: (".parquet", ".png", "_lines.parquet")
):

    rule:
        name:
            f"extract_exposure_{number}"
        input:
            of_exposure(unless_equal("extract", with_truth, measured_with), chips_of),
        output:
            [
                f"{OUT}/spectra/{{obsid}}_{chip}{end}"
                for chip, ends in files
                for end in ends
            ],
        log:
            f"{OUT}/logs/extract_exposure/{{obsid}}{alone}.log",
        wildcard_constraints:
            obsid="|".join(obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            runtime=more(2 + 2 * len(files)),
        params:
            recipe=recipes_of("measure", chips_of),
            chips=options_of(files),
        shell:
            "exec csstsim extract {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"
