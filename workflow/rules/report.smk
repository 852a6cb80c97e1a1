rule report:
    input:
        FILES.made("merge"),
        FILES.made("validate"),
        FILES.made("extract"),
        FILES.made("level0"),
    output:
        FILES.made("report") or FILES.outputs("report")[:1],
    log:
        f"{OUT}/logs/report.log",
    resources:
        mem_mb=memory("report"),
        runtime=minutes("report"),
    shell:
        "csstsim report {CAMPAIGN:q} > {log:q} 2>&1"
