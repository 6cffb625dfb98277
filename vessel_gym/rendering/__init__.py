"""Images of an episode with pygame, which is imported when the first image is drawn.

`scene` computes what an image shows, also for the pages of `agents.episodes`. What is around a
vehicle is the `vessel_gym.tasks.task.Workspace` of its task. This folder may import
simulation, filters' models and tasks; environments import it.
"""
