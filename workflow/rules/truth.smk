rule truth:
    output:
        f"{OUT}/truth/dataset/Norder=8/Dir={{dir}}/Npix={{pix}}.parquet",
    log:
        f"{OUT}/logs/truth/{{dir}}_{{pix}}.log",
    group:
        "truth"
    resources:
        mem_mb=more(1500),
        runtime=more(2),
    params:
        recipe=RUN.recipes.truth,
    shell:
        "csstsim truth {CAMPAIGN:q} --brick {wildcards.pix} > {log:q} 2>&1"
