# One chip in one process, from the catalogue to the Level-0 file, without intermediate files: `--config chips=whole`.
include: "measure.smk"


rule chip:
    input:
        FILES.unless_equal("level0", FILES.truth, FILES.psf),
    output:
        FILES.outputs("chip"),
    log:
        f"{OUT}/logs/chip/{{name}}_{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("chip"),
        runtime=minutes("select", "render", "chip"),
    params:
        recipe=FILES.recipe("chip"),
    shell:
        "csstsim chip {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


use rule chip as chip_spectra with:
    output:
        FILES.outputs("chip", orders=True),
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


ruleorder: chip_spectra > chip
