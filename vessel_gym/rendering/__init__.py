"""Images of an episode with pygame, which is imported when the first image is drawn.

`surroundings` describes what is around a vehicle, and `scene` computes what an image shows, also
for the pages of `agents.episodes`. This folder may import simulation, filters' models and tasks;
environments import it.
"""
