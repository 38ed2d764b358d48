"""Export: a folder that any Jetson can run, without JAX and without this package, and that proves itself on arrival."""
