"""The world in the clothes of other ecosystems: `gymnax`, `gymnasium`, `brax`, each in the module of its name.

Import the one you need; none of the three packages is a dependency of jaxnav. What they share is `observation`.
"""
