rule merge:
    input:
        FILES.on_brick("measure"),
    output:
        f"{OUT}/merge/dataset/Norder=8/Dir={{dir}}/Npix={{pix}}.parquet",
    log:
        f"{OUT}/logs/merge/{{dir}}_{{pix}}.log",
    group:
        "brick"
    resources:
        mem_mb=more(2500),
        runtime=more(4),
    shell:
        "csstsim merge {CAMPAIGN:q} --brick {wildcards.pix} > {log:q} 2>&1"


rule validate:
    input:
        FILES.merged,
        FILES.on_brick("measure"),
        FILES.on_brick("level0"),
    output:
        f"{OUT}/validate/{{pix}}.json",
        f"{OUT}/validate/{{pix}}.png",
    log:
        f"{OUT}/logs/validate/{{pix}}.log",
    group:
        "brick"
    resources:
        mem_mb=more(4000),
        runtime=more(4),
    params:
        recipe=RUN.recipes.validation,
    shell:
        "csstsim validate {CAMPAIGN:q} --brick {wildcards.pix} > {log:q} 2>&1"
