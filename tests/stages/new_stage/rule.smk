rule count:
    input:
        FILES.on_exposure("measure"),
    output:
        FILES.outputs("count"),
    log:
        f"{OUT}/logs/count/{{obsid}}.log",
    resources:
        mem_mb=memory("count"),
        runtime=minutes("count"),
    params:
        recipe=FILES.exposure_recipe("count"),
    shell:
        "csstsim count {CAMPAIGN:q} --obsid {wildcards.obsid} > {log:q} 2>&1"
