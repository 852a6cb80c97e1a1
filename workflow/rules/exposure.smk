# All chips of an exposure in one process, at choice: `--config chips=exposure`. Where a region is selected, exposures have
# different chips: a rule for each set of chips.
for number, (chips, obsids) in enumerate(exposures_by_chips().items()):

    rule:
        name:
            f"exposure_{number}"
        input:
            of_exposure(truth_of),
            of_exposure(psf_of),
        output:
            [
                f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{chip}_L0_V01.{product}"
                for chip, products in chips
                for product in products
            ],
        log:
            f"{OUT}/logs/exposure/{{name}}_{{obsid}}.log",
        wildcard_constraints:
            obsid="|".join(obsids),
        group:
            "chip"
        resources:
            mem_mb=more(3500),
            # Twice what a chip takes, and more where one part of it may be long
            runtime=more(4 + max(SELECTING, RENDERING) * len(chips)),
        params:
            recipe=of_exposure(lambda wildcards: [recipe("level0")(wildcards)]),
            chips=" ".join(f"--chip {int(chip)}" for chip, _ in chips),
        shell:
            'csstsim chip "$CAMPAIGN" --obsid {wildcards.obsid} {params.chips} > {log:q} 2>&1'
