# Calibrated images of single frames, for campaigns with measurement.keep_calibrated.
rule calibrate:
    input:
        FILES.level0,
        FILES.measured_with,
    output:
        FILES.outputs("calibrate"),
    log:
        f"{OUT}/logs/calibrate/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("calibrate"),
        runtime=minutes("calibrate"),
    params:
        recipe=FILES.recipe("calibrate"),
    shell:
        "csstsim calibrate {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"
