rule psf:
    input:
        FILES.library,
    output:
        FILES.outputs("psf"),
    log:
        f"{OUT}/logs/psf/{{chip}}.log",
    group:
        "psf"
    resources:
        mem_mb=memory("psf"),
        runtime=minutes("psf"),
    params:
        recipe=RUN.recipes.psf,
    shell:
        "csstsim psf {CAMPAIGN:q} --chip {wildcards.chip} > {log:q} 2>&1"
