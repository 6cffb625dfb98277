"""Images of an episode with pygame, which is imported when the first image is drawn.

One layout serves every task. `vessel_gym.rendering.surroundings` describes the surroundings of the
vehicle, and `vessel_gym.rendering.scene` computes the contents of images, also for the pages of
`agents.episodes`.

This folder may import the core and the tasks; environments import it to render.
"""
