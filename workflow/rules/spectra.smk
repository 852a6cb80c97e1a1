# Spectroscopic chips: the same stages with the truth of each order beside; spectra along the traces of that truth.
use rule render as render_spectra with:
    output:
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/render.fits"),
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/drawn.parquet"),
        temp(f"{CHIPS}/{{obsid}}_{{chip}}/orders.parquet"),
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


use rule level0 as level0_spectra with:
    input:
        stage_before("readout"),
        drawn_before,
        f"{CHIPS}/{{obsid}}_{{chip}}/orders.parquet",
    output:
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_L0_V01.fits",
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_L0_V01.truth.parquet",
        f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_L0_V01.orders.parquet",
    wildcard_constraints:
        obsid=SPECTRA_OBSID,
        chip=SPECTRA_CHIP,


ruleorder: render_spectra > render
ruleorder: level0_spectra > level0


rule extract:
    input:
        level0_of,
        truth_of_level0,
        f"{OUT}/psf/chip_{{chip}}.h5",
        masters_of,
    output:
        f"{OUT}/spectra/{{obsid}}_{{chip}}.parquet",
        f"{OUT}/spectra/{{obsid}}_{{chip}}.png",
    log:
        f"{OUT}/logs/extract/{{obsid}}_{{chip}}.log",
    benchmark:
        f"{OUT}/benchmarks/extract/{{obsid}}_{{chip}}.tsv"
    group:
        "chip"
    resources:
        mem_mb=more(4000),
        runtime=more(4),
    params:
        how=MEASUREMENT,
    shell:
        'csstsim extract "$CAMPAIGN" --obsid {wildcards.obsid} --chip {wildcards.chip} > {log:q} 2>&1'
