"""How well a ranking holds on other plants: a few of its designs, driven on plants that differ in one option each."""
