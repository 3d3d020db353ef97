"""The paper's figures 2 to 5: what is photographed, what is drawn, and the sheets on which it stands."""
