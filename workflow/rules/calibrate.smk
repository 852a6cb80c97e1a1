# Calibrated images, for campaigns that keep them (measurement.keep_calibrated).
rule calibrate:
    input:
        FILES.level0,
        FILES.measured_with,
    output:
        f"{OUT}/calibrated/{{obsid}}_{{chip}}.fits",
    log:
        f"{OUT}/logs/calibrate/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(2500),
        runtime=more(3),
    params:
        recipe=FILES.recipe("measure"),
    shell:
        "csstsim calibrate {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"
