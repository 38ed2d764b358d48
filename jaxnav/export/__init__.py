"""Export: a folder with a policy that any Jetson runs, without JAX and this package, and that checks itself there."""
