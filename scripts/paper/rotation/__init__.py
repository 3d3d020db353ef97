"""The paper's tables I to III: photographs under a light that is believed to be turned."""
