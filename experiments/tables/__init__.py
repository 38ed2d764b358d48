"""The three tables: learners and scripted robots in every scene, with tuned hyperparameters."""
