# Pictures of Level-0 files. The picture of one frame, and its inputs, have priority over all other jobs (prioritize in
# profiles/), so that it is finished long before the report. With wildcards, the rule is not a target by itself.
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
