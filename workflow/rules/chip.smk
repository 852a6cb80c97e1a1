# One chip in four stages, and what measures it after: on a cluster they travel together (group), and what one hands to
# the next is dropped when used. mem_mb and runtime [min] leave room above what was measured: docs/slurm.md has it.
SELECTING = 3 if RUN.embedded else 60  # spectra of a user's catalogue come one by one
RENDERING = {"noise_free": 30, "reference": 600}.get(RUN.config.fidelity, 4)


rule select:
    input:
        truth_of,
    output:
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/select.parquet"),
    log:
        f"{OUT}/logs/select/{{obsid}}_{{chip}}.log",
    benchmark:
        f"{OUT}/benchmarks/select/{{obsid}}_{{chip}}.tsv"
    group:
        "chip"
    resources:
        mem_mb=more(1500),
        runtime=more(SELECTING),
    params:
        recipe=recipe,
    shell:
        'csstsim select "$CAMPAIGN" --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1'


rule render:
    input:
        objects_of,
    output:
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/render.fits"),
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/drawn.parquet"),
    log:
        f"{OUT}/logs/render/{{obsid}}_{{chip}}.log",
    benchmark:
        f"{OUT}/benchmarks/render/{{obsid}}_{{chip}}.tsv"
    group:
        "chip"
    resources:
        mem_mb=more(3000),
        runtime=more(RENDERING),
    params:
        recipe=recipe,
    shell:
        'csstsim render "$CAMPAIGN" --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1'


rule readout:
    input:
        stage_before("render"),
    output:
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/readout.fits"),
    log:
        f"{OUT}/logs/readout/{{obsid}}_{{chip}}.log",
    benchmark:
        f"{OUT}/benchmarks/readout/{{obsid}}_{{chip}}.tsv"
    group:
        "chip"
    resources:
        mem_mb=more(1500),
        runtime=more(2),
    params:
        recipe=recipe,
    shell:
        'csstsim readout "$CAMPAIGN" --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1'


rule level0:
    input:
        stage_before("readout"),
        drawn_before,
    output:
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_L0_V01.fits",
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_L0_V01.truth.parquet",
    log:
        f"{OUT}/logs/level0/{{name}}_{{obsid}}_{{chip}}.log",
    benchmark:
        f"{OUT}/benchmarks/level0/{{name}}_{{obsid}}_{{chip}}.tsv"
    group:
        "chip"
    resources:
        mem_mb=more(1500),
        runtime=more(2),
    params:
        recipe=recipe,
    shell:
        'csstsim level0 "$CAMPAIGN" --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1'
