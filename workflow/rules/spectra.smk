# Spectra of the objects on a spectroscopic chip, box and optimal, along the truth's traces.
rule extract:
    input:
        level0_of,
        f"{OUT}/psf/chip_{{chip}}.h5",
    output:
        f"{OUT}/spectra/{{obsid}}_{{chip}}.parquet",
    log:
        f"{OUT}/logs/extract/{{obsid}}_{{chip}}.log",
    benchmark:
        f"{OUT}/benchmarks/extract/{{obsid}}_{{chip}}.tsv"
    resources:
        mem_mb=4000,
        runtime=20,
    shell:
        'csstsim extract "$CAMPAIGN" --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1'
