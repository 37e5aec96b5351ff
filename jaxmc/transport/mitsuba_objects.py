"""Mitsuba's own objects in the description of a scene.

This module imports nothing, so that a process that has Mitsuba but not JAX can run it too.
"""


def with_objects(mi, data):
    """Return plain data, as ``mitsuba_scenes.describe`` returns them, as ``mi.load_dict`` takes them.

    ``mi`` is the module ``mitsuba``, its variant set: matrices become its transforms and triangles its meshes.
    """
    if data["type"] == "mesh":
        return _mesh(mi, data)
    return {key: _value(mi, key, value) for key, value in data.items()}


def _value(mi, key, value):
    if key == "to_world":
        return mi.ScalarTransform4f(value)
    return with_objects(mi, value) if isinstance(value, dict) else value


def _mesh(mi, data):
    properties = mi.Properties()
    for key in ("bsdf", "emitter"):
        if key in data:
            properties[key] = mi.load_dict(with_objects(mi, data[key]))
    mesh = mi.Mesh("mesh", len(data["vertices"]), len(data["faces"]), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = [x for vertex in data["vertices"] for x in vertex]
    parameters["faces"] = [i for face in data["faces"] for i in face]
    parameters.update()
    return mesh
