# Spectra of spectroscopic chips, along the traces of the truth beside them.
rule extract:
    input:
        with_truth,
        f"{OUT}/psf/chip_{{chip}}.h5",
        masters_of,
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
        'csstsim extract "$CAMPAIGN" --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1'
