"""Simulated captures: what is photographed, the scene around the ball, and what the camera makes of its light."""
