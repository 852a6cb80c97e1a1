# All chips of an exposure in one process, at choice: `--config chips=exposure`. A process sees (exec) if Snakemake was killed. Where a region is selected, exposures have
# different chips: a rule for each set of chips. A chip that failed among others has a rule of its own.


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
            # Twice what a chip takes, and more where one part of it may be long
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
