rule psf:
    input:
        FILES.library,
    output:
        f"{OUT}/psf/chip_{{chip}}.h5",
        f"{OUT}/psf/chip_{{chip}}_tables.h5",
    log:
        f"{OUT}/logs/psf/{{chip}}.log",
    group:
        "psf"
    resources:
        mem_mb=more(1500),
        runtime=more(5),
    params:
        recipe=RUN.recipes.psf,
    shell:
        "csstsim psf {CAMPAIGN:q} --chip {wildcards.chip} > {log:q} 2>&1"
