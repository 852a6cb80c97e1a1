"""One job while it runs: its state, the layers in their order, and what a layer promises."""
