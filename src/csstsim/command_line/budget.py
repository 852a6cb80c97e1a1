"""`csstsim budget`: what each effect costs a measurement of shear, or of redshifts."""

import click

from csstsim.command_line.group import GivenPath


class Budgets(click.Group):
    """The group of budgets, which refuse empty names of files as all commands do."""

    def add_command(self, cmd, name=None):
        """Add a budget."""
        for param in cmd.params:
            if type(param.type) is click.Path:
                param.type = GivenPath()
        super().add_command(cmd, name)


@click.group(cls=Budgets)
def budget():
    """Say what each effect costs a measurement: shear, redshifts.

    \b
    For example:
      csstsim budget shear --plan
    """


@budget.command()
@click.argument("plan", required=False, type=click.Path())
@click.option(
    "--output", type=click.Path(), default="results/budget_shear", show_default=True, help="Folder of results."
)
@click.option("--plan", "only_plan", is_flag=True, help="Print volume and CPU-hours for sigma(m) = 1e-4; then stop.")
def shear(plan, output, only_plan):
    """Measure what each effect adds to the bias of shear."""
    raise click.UsageError("not yet")
