"""Replays and figures. meshcat, coal and matplotlib are looked for only when something is shown."""
