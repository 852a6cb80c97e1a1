rule truth:
    output:
        FILES.outputs("truth"),
    log:
        f"{OUT}/logs/truth/{{dir}}_{{pix}}.log",
    group:
        "truth"
    resources:
        mem_mb=memory("truth"),
        runtime=minutes("truth"),
    params:
        recipe=RUN.recipes.truth,
    shell:
        "csstsim truth {CAMPAIGN:q} --brick {wildcards.pix} > {log:q} 2>&1"
