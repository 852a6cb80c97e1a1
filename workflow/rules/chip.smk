# One chip from the catalogue to its files in one process, with nothing handed on by way of the disk, at choice: `--config chips=whole`.
include: "measure.smk"


rule chip:
    input:
        FILES.unless_equal("level0", FILES.truth, FILES.psf),
    output:
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.fits",
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.truth.parquet",
        CAT,
    log:
        f"{OUT}/logs/chip/{{name}}_{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(3500),
        runtime=more(SELECTING + RENDERING + 4),
    params:
        recipe=FILES.recipe("level0"),
    shell:
        "csstsim chip {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


use rule chip as chip_spectra with:
    output:
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.fits",
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.truth.parquet",
        CAT,
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.orders.parquet",
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


ruleorder: chip_spectra > chip
