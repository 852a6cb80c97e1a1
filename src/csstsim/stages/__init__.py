"""What the rules of the workflow do: a file a rule, of the name of the rule and of its command.

In each: a function that works in memory, and one that reads what it needs, calls it and writes the product. A stage
refuses an input whose recorded recipe (digests of campaign, camera, layers and exposure) is not its own, and gives its
products that recipe on. Nothing appears under its name before it is complete.
"""
