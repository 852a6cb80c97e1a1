# All chips of an exposure in one process, at choice: `--config chips=exposure`. A process sees (exec) if Snakemake was killed. Where a region is selected, exposures have
# different chips: a rule for each set of chips. A chip that failed among others has a rule of its own.


def level0_endings(obsid, chip):
    orders = ["orders.parquet"] * (chip in DISPERSED.get(obsid, ()))
    text = ["cat"] * ("cat" in RUN.config.truth)
    return "fits", "truth.parquet", *text, *orders


for alike in FILES.groups(RUN.jobs, "level0", level0_endings):

    rule:
        name:
            f"exposure_{alike.number}"
        input:
            of_exposure(FILES.unless_equal("level0", FILES.truth, FILES.psf), alike),
        output:
            [
                f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{chip}_{ENDING}.{end}"
                for chip, ends in alike.files
                for end in ends
            ],
        log:
            f"{OUT}/logs/exposure/{{name}}_{{obsid}}{alike.log}.log",
        wildcard_constraints:
            obsid="|".join(alike.obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            # Twice what a chip takes, and more where one part of it may be long
            runtime=more(4 + max(SELECTING, RENDERING) * len(alike.files)),
        params:
            recipe=FILES.recipes("level0", alike),
            chips=alike.options,
        shell:
            "exec csstsim chip {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"


for alike in FILES.groups(RUN.imaging_jobs, "measure", lambda *_: (".parquet",)):

    rule:
        name:
            f"measure_exposure_{alike.number}"
        input:
            of_exposure(
                FILES.unless_equal("measure", FILES.level0, FILES.measured_with), alike
            ),
        output:
            [
                f"{OUT}/measure/{{obsid}}_{chip}{end}"
                for chip, ends in alike.files
                for end in ends
            ],
        log:
            f"{OUT}/logs/measure_exposure/{{obsid}}{alike.log}.log",
        wildcard_constraints:
            obsid="|".join(alike.obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            runtime=more(2 + 2 * len(alike.files)),
        params:
            recipe=FILES.recipes("measure", alike),
            chips=alike.options,
        shell:
            "exec csstsim measure {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"


for alike in FILES.groups(
    RUN.slitless_jobs, "extract", lambda *_: (".parquet", ".png", "_lines.parquet")
):

    rule:
        name:
            f"extract_exposure_{alike.number}"
        input:
            of_exposure(
                FILES.unless_equal(
                    "extract", FILES.level0_and_truth, FILES.measured_with
                ),
                alike,
            ),
        output:
            [
                f"{OUT}/spectra/{{obsid}}_{chip}{end}"
                for chip, ends in alike.files
                for end in ends
            ],
        log:
            f"{OUT}/logs/extract_exposure/{{obsid}}{alike.log}.log",
        wildcard_constraints:
            obsid="|".join(alike.obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            runtime=more(2 + 2 * len(alike.files)),
        params:
            recipe=FILES.recipes("measure", alike),
            chips=alike.options,
        shell:
            "exec csstsim extract {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"
