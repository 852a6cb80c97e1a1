# What is measured on a chip: sources of imaging chips and spectra, a process a chip.
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


# Of spectroscopic chips, along the traces of the truth beside the Level-0 file.
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
