"""The losses of the learners: pure functions of parameters and a batch, each with the equation that it computes."""
