# All chips of an exposure in one process, at choice: `--config chips=exposure`. A process sees (exec) if Snakemake was killed. Where a region is selected, exposures have
# different chips: a rule for each set of chips.
ALL = by_exposure(RUN.jobs)
IMAGING = by_exposure(RUN.imaging_jobs)
DISPERSED = by_exposure(RUN.slitless_jobs)


def level0_endings(obsid, chip):
    orders = ["orders.parquet"] * (chip in DISPERSED.get(obsid, ()))
    text = ["cat"] * ("cat" in RUN.config.truth)
    return "fits", "truth.parquet", *text, *orders


for number, (files, obsids) in enumerate(named_alike(ALL, level0_endings).items()):

    rule:
        name:
            f"exposure_{number}"
        input:
            of_exposure(unless_equal("level0", truth_of, psf_of), ALL),
        output:
            [
                f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{chip}_{ENDING}.{end}"
                for chip, ends in files
                for end in ends
            ],
        log:
            f"{OUT}/logs/exposure/{{name}}_{{obsid}}.log",
        wildcard_constraints:
            obsid="|".join(obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            # Twice what a chip takes, and more where one part of it may be long
            runtime=more(4 + max(SELECTING, RENDERING) * len(files)),
        params:
            recipe=recipes_of("level0", ALL),
            chips=options_of(files),
        shell:
            "exec csstsim chip {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"


for number, (files, obsids) in enumerate(
    named_alike(IMAGING, lambda *_: (".parquet",)).items()
):

    rule:
        name:
            f"measure_exposure_{number}"
        input:
            of_exposure(unless_equal("measure", level0_of, measured_with), IMAGING),
        output:
            [
                f"{OUT}/measure/{{obsid}}_{chip}{end}"
                for chip, ends in files
                for end in ends
            ],
        log:
            f"{OUT}/logs/measure_exposure/{{obsid}}.log",
        wildcard_constraints:
            obsid="|".join(obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            runtime=more(2 + 2 * len(files)),
        params:
            recipe=recipes_of("measure", IMAGING),
            chips=options_of(files),
        shell:
            "exec csstsim measure {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"


for number, (files, obsids) in enumerate(
    named_alike(DISPERSED, lambda *_: (".parquet", ".png", "_lines.parquet")).items()
):

    rule:
        name:
            f"extract_exposure_{number}"
        input:
            of_exposure(unless_equal("extract", with_truth, measured_with), DISPERSED),
        output:
            [
                f"{OUT}/spectra/{{obsid}}_{chip}{end}"
                for chip, ends in files
                for end in ends
            ],
        log:
            f"{OUT}/logs/extract_exposure/{{obsid}}.log",
        wildcard_constraints:
            obsid="|".join(obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            runtime=more(2 + 2 * len(files)),
        params:
            recipe=recipes_of("measure", DISPERSED),
            chips=options_of(files),
        shell:
            "exec csstsim extract {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"
