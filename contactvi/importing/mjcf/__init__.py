"""MJCF files through MuJoCo's own compiler: what it makes of a file becomes a Pinocchio model and data of a scene.

`compiler` compiles the file, `tree` makes bodies and joints of the result, `shapes` and `contacts` the geometries with
the pairs that may touch, `forces` springs and constraints, `actuators` servos, `states` the maps of qpos and qvel.
`model` puts it together.
"""
