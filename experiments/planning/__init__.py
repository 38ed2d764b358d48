"""Scripted robots and plans by gradient: what planning and dialogue are worth without learning."""
