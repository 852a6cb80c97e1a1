rule count:
    input:
        FILES.of_job("measure"),
    output:
        FILES.outputs("count"),
    log:
        f"{OUT}/logs/count/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("count"),
        runtime=minutes("count"),
    params:
        recipe=FILES.recipe("count"),
    shell:
        "csstsim count {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"
