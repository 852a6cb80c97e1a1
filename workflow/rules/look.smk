# Pictures of Level-0 files. That of one frame comes long before the report: it, and what it needs, go before all else
# (prioritize in profiles/). The wildcards keep Snakemake from making it a target wherever it is prioritized.
rule look:
    input:
        frame=FILES.level0,
        truth=FILES.of_job("level0"),
    output:
        f"{OUT}/look/{{obsid}}_{{chip}}.png",
    log:
        f"{OUT}/logs/look/{{obsid}}_{{chip}}.log",
    resources:
        mem_mb=more(1500),
        runtime=more(3),
    shell:
        "csstsim show {input.frame:q} --subtract-overscan --truth --limit 40 --output {output:q} > {log:q} 2>&1"
