# One chip in four stages, the default, and what measures it after: on a cluster they travel together (group), and what one
# hands to the next is dropped when used. mem_mb and runtime [min] leave room above what was measured: docs/slurm.md has it.
include: "measure.smk"


rule select:
    input:
        FILES.truth,
    output:
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/select.parquet"),
    log:
        f"{OUT}/logs/select/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(1500),
        runtime=more(SELECTING),
    params:
        recipe=FILES.recipe("select"),
    shell:
        "csstsim select {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


rule render:
    input:
        FILES.objects,
    output:
        kept(f"{CHIPS}/{{obsid}}_{{chip}}/render.fits"),
        kept(f"{CHIPS}/{{obsid}}_{{chip}}/drawn.parquet"),
    log:
        f"{OUT}/logs/render/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(3000),
        runtime=more(RENDERING),
    params:
        recipe=FILES.recipe("render"),
    shell:
        "csstsim render {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


rule readout:
    input:
        FILES.stage_before("render"),
    output:
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/readout.fits"),
    log:
        f"{OUT}/logs/readout/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(1500),
        runtime=more(2),
    params:
        recipe=FILES.recipe("readout"),
    shell:
        "csstsim readout {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


rule level0:
    input:
        FILES.unless_equal("level0", FILES.stage_before("readout"), FILES.rendered),
    output:
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.fits",
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.truth.parquet",
        CAT,
    log:
        f"{OUT}/logs/level0/{{name}}_{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=more(1500),
        runtime=more(2),
    params:
        recipe=FILES.recipe("level0"),
    shell:
        "csstsim level0 {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


# Spectroscopic chips: the same stages with the truth of each order beside.
use rule render as render_spectra with:
    output:
        kept(f"{CHIPS}/{{obsid}}_{{chip}}/render.fits"),
        kept(f"{CHIPS}/{{obsid}}_{{chip}}/drawn.parquet"),
        kept(f"{CHIPS}/{{obsid}}_{{chip}}/orders.parquet"),
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


use rule level0 as level0_spectra with:
    output:
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.fits",
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.truth.parquet",
        CAT,
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.orders.parquet",
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


ruleorder: render_spectra > render
ruleorder: level0_spectra > level0
