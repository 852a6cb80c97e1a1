rule merge:
    input:
        FILES.on_brick("measure"),
        FILES.joint_with,
    output:
        FILES.outputs("merge"),
    log:
        f"{OUT}/logs/merge/{{dir}}_{{pix}}.log",
    group:
        "brick"
    resources:
        mem_mb=memory("merge"),
        runtime=minutes("merge"),
    shell:
        "csstsim merge {CAMPAIGN:q} --brick {wildcards.pix} > {log:q} 2>&1"


rule validate:
    input:
        FILES.merged,
        FILES.on_brick("measure"),
        FILES.on_brick("level0"),
    output:
        FILES.outputs("validate"),
    log:
        f"{OUT}/logs/validate/{{pix}}.log",
    group:
        "brick"
    resources:
        mem_mb=memory("validate"),
        runtime=minutes("validate"),
    params:
        recipe=RUN.recipes.validation,
    shell:
        "csstsim validate {CAMPAIGN:q} --brick {wildcards.pix} > {log:q} 2>&1"
