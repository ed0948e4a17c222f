"""The road of a cloud, from a recording to a recording: plan, engine, steps, result."""
