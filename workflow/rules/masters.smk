# Master calibration frames of a chip, for the campaigns that name this one in measurement.masters.
rule masters:
    input:
        FILES.calibration_frames,
    output:
        f"{OUT}/masters/chip_{{chip}}.fits",
    log:
        f"{OUT}/logs/masters/{{chip}}.log",
    resources:
        mem_mb=more(3500),
        runtime=more(8),
    shell:
        "csstsim masters {CAMPAIGN:q} --chip {wildcards.chip} > {log:q} 2>&1"
