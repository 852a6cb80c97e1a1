# What is measured on a chip: sources of imaging chips and spectra, a process a chip.
rule measure:
    input:
        unless_equal("measure", level0_of, measured_with),
    output:
        f"{OUT}/measure/{{obsid}}_{{chip}}.parquet",
    log:
        f"{OUT}/logs/measure/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(3500),
        runtime=more(4),
    params:
        recipe=recipe("measure"),
    shell:
        "csstsim measure {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


# Of spectroscopic chips, along the traces of the truth beside the Level-0 file.
rule extract:
    input:
        unless_equal("extract", with_truth, measured_with),
    output:
        f"{OUT}/spectra/{{obsid}}_{{chip}}.parquet",
        f"{OUT}/spectra/{{obsid}}_{{chip}}.png",
        f"{OUT}/spectra/{{obsid}}_{{chip}}_lines.parquet",
    log:
        f"{OUT}/logs/extract/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(2500),
        runtime=more(4),
    params:
        recipe=recipe("measure"),
    shell:
        "csstsim extract {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"
