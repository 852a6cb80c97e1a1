# Master calibration frames of a chip, for campaigns with this one in measurement.masters.
rule masters:
    input:
        FILES.calibration_frames,
    output:
        FILES.outputs("masters"),
    log:
        f"{OUT}/logs/masters/{{chip}}.log",
    resources:
        mem_mb=memory("masters"),
        runtime=minutes("masters"),
    shell:
        "csstsim masters {CAMPAIGN:q} --chip {wildcards.chip} > {log:q} 2>&1"
