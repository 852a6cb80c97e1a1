# Measurements of a chip, one process per chip: sources of imaging chips, spectra of slitless chips.
rule measure:
    input:
        FILES.unless_equal("measure", FILES.level0, FILES.measured_with),
    output:
        FILES.outputs("measure"),
    log:
        f"{OUT}/logs/measure/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("measure"),
        runtime=minutes("measure"),
    params:
        recipe=FILES.recipe("measure"),
    shell:
        "csstsim measure {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


# Spectra are extracted along the traces in the truth of the Level-0 file.
rule extract:
    input:
        FILES.unless_equal("extract", FILES.of_job("level0"), FILES.measured_with),
    output:
        FILES.outputs("extract"),
    log:
        f"{OUT}/logs/extract/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("extract"),
        runtime=minutes("extract"),
    params:
        recipe=FILES.recipe("extract"),
    shell:
        "csstsim extract {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"
