# All chips of an exposure in one process: `--config chips=exposure`. With a selected region, exposures have different
# chips, so there is a rule for each set of chips. A chip that failed in such a job has a separate rule. `exec` makes
# Snakemake the parent of the process, which can then detect that Snakemake was killed.


for alike in FILES.groups(RUN.jobs, "level0"):

    rule:
        name:
            f"exposure_{alike.number}"
        input:
            of_exposure(FILES.unless_equal("level0", FILES.truth, FILES.psf), alike),
        output:
            alike.outputs,
        log:
            f"{OUT}/logs/exposure/{{name}}_{{obsid}}{alike.log}.log",
        wildcard_constraints:
            obsid="|".join(alike.obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            # Twice the time of a chip, and more if its selection or rendering may be long
            runtime=more(
                FILES.minutes("chip")
                + max(FILES.minutes("select"), FILES.minutes("render"))
                * len(alike.files)
            ),
        params:
            recipe=FILES.recipes("chip", alike),
            chips=alike.options,
        shell:
            "exec csstsim chip {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"


for alike in FILES.groups(RUN.imaging_jobs, "measure"):

    rule:
        name:
            f"measure_exposure_{alike.number}"
        input:
            of_exposure(
                FILES.unless_equal("measure", FILES.level0, FILES.measured_with), alike
            ),
        output:
            alike.outputs,
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


for alike in FILES.groups(RUN.slitless_jobs, "extract"):

    rule:
        name:
            f"extract_exposure_{alike.number}"
        input:
            of_exposure(
                FILES.unless_equal(
                    "extract", FILES.of_job("level0"), FILES.measured_with
                ),
                alike,
            ),
        output:
            alike.outputs,
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
            recipe=FILES.recipes("extract", alike),
            chips=alike.options,
        shell:
            "exec csstsim extract {CAMPAIGN:q} --resume --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1"
