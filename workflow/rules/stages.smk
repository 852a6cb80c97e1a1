# One chip in four stages (the default), then its measurement. On a cluster they form one group job. Intermediate files
# are removed after use. mem_mb and runtime [min] are larger than the measured values in docs/slurm.md.
include: "measure.smk"


rule select:
    input:
        FILES.truth,
    output:
        temp(FILES.outputs("select")),
    log:
        f"{OUT}/logs/select/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("select"),
        runtime=minutes("select"),
    params:
        recipe=FILES.recipe("select"),
    shell:
        "csstsim select {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


rule render:
    input:
        FILES.objects,
    output:
        kept(FILES.outputs("render")),
    log:
        f"{OUT}/logs/render/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("render"),
        runtime=minutes("render"),
    params:
        recipe=FILES.recipe("render"),
    shell:
        "csstsim render {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


rule readout:
    input:
        FILES.stage_before("render"),
    output:
        temp(FILES.outputs("readout")),
    log:
        f"{OUT}/logs/readout/{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("readout"),
        runtime=minutes("readout"),
    params:
        recipe=FILES.recipe("readout"),
    shell:
        "csstsim readout {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


rule level0:
    input:
        FILES.unless_equal("level0", FILES.stage_before("readout"), FILES.rendered),
    output:
        FILES.outputs("level0"),
    log:
        f"{OUT}/logs/level0/{{name}}_{{obsid}}_{{chip}}.log",
    group:
        "chip"
    resources:
        mem_mb=memory("level0"),
        runtime=minutes("level0"),
    params:
        recipe=FILES.recipe("level0"),
    shell:
        "csstsim level0 {CAMPAIGN:q} --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1"


# Slitless chips: the same stages, with the truth of each order in addition.
use rule render as render_spectra with:
    output:
        kept(FILES.outputs("render", orders=True)),
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


use rule level0 as level0_spectra with:
    output:
        FILES.outputs("level0", orders=True),
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


ruleorder: render_spectra > render
ruleorder: level0_spectra > level0
