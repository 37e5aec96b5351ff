"""Scenes in motion of which the value is a closed form, and with it every derivative: on a film, at a point, on a ray.

``SCENES`` lists them. ``make(params)`` returns what an estimator takes before its options:

* "film": (scene, camera), for the mean radiance over the film;
* "point": (scene, point, normal), for an irradiance;
* "ray": (scene, origin, direction), for a radiance.
"""

from moving_contacts import CONTACTS
from moving_films import FRONT, ZOOMS
from moving_mirrors import MIRRORED
from moving_points import POINTS, RAYS
from moving_skies import SKIES

SCENES = (*FRONT, *ZOOMS, *CONTACTS, *MIRRORED, *POINTS, *RAYS, *SKIES)
