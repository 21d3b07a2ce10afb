"""What a scene may not say is refused in one sentence that names file, key and value, before anything is solved."""

import tomllib

import pytest

from homogenize import default_law
from macro_fem import read_scene, solve
from macro_fem.motion import MovingCurtain
from rve import InputError

BASE = """
curtain = {width = 100.0, height = 100.0}
mesh = {cells = 4}
support = {kind = "top"}
"""
REFUSED = """
curtain.width = nan -> [curtain] width = nan
curtain.width = 1e9 -> units
mesh.cells = 20000 -> use fewer
curtain = {shape = "file", file = "mesh.msh"} -> cells = 4: has no effect with shape = "file"
curtain = {shape = "square"} -> shape = 'square': is not one of rectangle, disk, outline, file, dxf
curtain.areal_mass = 2785
  -> [curtain] areal_mass = 2785: expected a number <= 100.0 kg/m2; did you mean 2.785, from g/m2?
curtain.width = "3 m" -> width = '3 m': expected a number, got a text; write the number alone, in mm: 3000
curtain.width = "1,5" -> width = '1,5': expected a number, got a text; has a decimal comma; write 1.5
curtain.weave_angle = "45 deg" -> nor a number of degrees; write the number alone, in degrees: 45
curtain = {shape = "Disc", radius = 50} -> did you mean disk?
material.density = 7.85 -> density = 7.85: expected a number >= 100.0 kg/m3; did you mean 7850, from g/cm3?
material.young = 210 -> young = 210: expected a number >= 500.0 N/mm2; did you mean 210000, from GPa?
material.material = "Steel_1.4301" -> material = 'Steel_1.4301': did you mean steel 1.4301? known are steel,
load = [{kind = "point", at = [0, 0], force = [0, -1]}] -> [load] kind = 'point': write [[load.point]]
load = {kind = "winds"} -> [load] kind = 'winds': is not one of edge, point, patch, bar, wind; did you mean wind?
wind = {pressure = 3} -> 'wind': unknown table; write [[load.wind]]
hooks = {pitch = 50} -> 'hooks': unknown table; write [[support]] kind = "hooks"
support = {hooks = {pitch = 50}} -> [support] kind: is missing; write [[support]] kind = "hooks"
support = {pitch = 50} -> [support] kind: is missing; it is one of corners, top
support = {kind = "bar"} -> is not one of corners, top, rail, hooks, edge, point, track; write [[load.bar]]
support = {kind = "Hook", pitch = 50} -> track; did you mean hooks?
support = {kind = "edge", edge = "Rihgt"}
  -> 'Rihgt': the curtain has no such edge, only bottom, left, outline, right, top; did you mean right?
support = {kind = "hooks", pitch = "20 cm"}
  -> pitch = '20 cm': expected a number, got a text; write the number alone, in mm: 200
support = {kind = "hooks", count = "12"} -> expected a whole number, got a text; write it without quotes
support = {kind = "point", at = [0,5, 99,5]} -> a list of length 2, got 4; a decimal comma is written as a point
support = {kind = "track", path = [[0, 0], [0.06, 0]]}
  -> path: length = 0.06: is less than the radius of a ring, 5 mm; lengths are in mm, did you mean 60?
support = {kind = "track", fullness = 0.5} -> move the supports together or use a fullness of at least 0.632
support = {kind = "edge", edge = "top", along = [[0, 0.1], [0.1, 0.1]]} -> (edge) along: length = 0.1: is less than
load.point = {at = [0, 0], force = "0.5 kN"} -> expected a list, got a text; write the number alone, in N: 500
load.point = {at = [0, 0], force = [0, "-0.5 kN"]}
  -> force[1] = '-0.5 kN': expected a number, got a text; write the number alone, in N: -500
load.edge = {edge = "bottom", force = [0, "2 kN/m"]} -> write the number alone, in N/mm: 2
load.wind = {direction = [0, 0, 1], pressure = "0.3 kPa"} -> write the number alone, in N/m2: 300
load.wind = {direction = [0, 0, 1], speed = "90 km/h"} -> write the number alone, in m/s: 25
load.gravity = 9810 -> gravity = 9810: expected a number <= 1000.0 m/s2; did you mean 9.81, from mm/s2?
load.bar = {mass = "2 stone"} -> mass = '2 stone': expected a number, got a text; write the number alone, in kg
load.patch = {at = [50, 50], radius = 0.02, force = [0, -1]}
  -> radius = 0.02: is less than the radius of a ring, 5 mm; lengths are in mm, did you mean 20? (0.02 metres)
load.patch = {at = [50, 50], radius = 101, force = [0, -1]}
  -> [load.patch] radius = 101: is larger than the curtain, 100 mm across, were metres meant?
obstacle = [{kind = "wall", facing = [0, 1], name = "a"}, {kind = "floor", name = "a"}] -> name = 'a': is that of two
motion.duration = 1.0; body = [{name = "b", kind = "sphere", radius = 9, mass = 1, at = [0, 0, 99]},
  {name = "b", kind = "sphere", radius = 9, mass = 1, at = [0, 0, 150]}] -> [[body]] name = 'b': is that of two
motion.duration = 1.0; body = {kind = "sphere", radius = 0.05, mass = 1, at = [0, 5, 99]} -> were 0.05 m meant?
motion.duration = 1.0; curtain.width = 3.0 -> width = 3: is less than the mean diameter of a ring, 10 mm
motion.duration = "2 min" -> duration = '2 min': expected a number, got a text; write the number alone, in s: 120
curtain.weave_angel = "y" -> did you mean weave_angle?
solvr = {} -> solvr: unknown table
width = 400 -> width = 400: stands in no table; known are curtain, support
mehs = 8 -> mehs = 8: stands in no table; did you mean mesh?
support = {kind = "top", gather = 1.9} -> farther apart
support = {kind = "hooks", pitch = 500.0} -> pitch = 500
support = {kind = "hooks", pitch = 50.0, capacity = true} -> capacity = True
support = {kind = "hooks", pitch = 25, sliding = true, gather = 0.8} -> gather = 0.8: has no effect on hooks
support = {kind = "top", move = [1, 2, 3, 4]} -> (top) move = [1, 2, 3, 4]: expected a list of length <= 3
support = {kind = "point", at = [0, 1, 2]} -> at = [0, 1, 2]: expected a list of length 2
support = {kind = "edge", edge = "top", held = "zx"} -> held = 'zx': is not one of both, x, y, z, xy, xz, yz
support = {kind = "edge", edge = "top", held = "z"} -> held = 'z': holds nothing, as the scene lies in the plane
support = {kind = "edge", edge = "top", held = "xy", move = [0, 0, 1]} -> has no effect along z, as held = 'xy'
support = {kind = "edge", edge = "left", held = "x", move = [0, 5]} -> [0.0, 5.0]: has no effect along y
support = {kind = "edge", edge = "left", sliding = true} -> (edge) sliding = true: has no effect without along
support = {kind = "edge", edge = "left", along = [[0, 0, 0], [0, 0, 0]]} -> (0.0, 0.0, 0.0)]: is no line
support = {kind = "edge", edge = "left", along = [[0, 0], [0, 99]], gather = 0.9}
  -> gather = 0.9: has no effect with along
support = {kind = "edge", edge = "left", along = [[0, 0], [0, 99]], held = "x"} -> held = 'x': has no effect with along
support = {kind = "track", radius = 50.0} -> (track) angle: is missing
support = {kind = "track", path = [[0, 0], [0, 0]]} -> path: holds [0, 0] twice in a row
support = {kind = "track", path = [[0, 0], [50, 0]], angle = 20.0} -> angle = 20: is not used together with path
support = {kind = "track", fullness = 1.5, angle = 0.0} -> angle = 0: makes no arc
support = {kind = "track", fullness = 1.5, side = "end"} -> side = 'end': has no effect with drawn = 1
support = {kind = "track", fullness = 1.5, capacity = 5.0} -> capacity = 5: has no effect without pitch
support = {kind = "track", fullness = 1.5, rings_per_hook = 2} -> rings_per_hook = 2: has no effect without pitch
support = {kind = "track", fullness = 2.0, path = [[0, 0], [200, 0]]} -> fullness = 2: contradicts a track of 200 mm
support = {kind = "track", fullness = 0.5, radius = 5.0} -> radius = 5: a track of 200 mm
load.steps = 3 -> steps = 3: has no effect without live loads and moves
load.point = {at = [0, 0]} -> [load.point] force: is missing
load.bar = {mass = 1.0, edge = "top"} -> held
support.kind = "rail"; load.edge = {edge = "bottom", force = [0.1, 0.0]} -> nothing carries the force of 10 N along x
support = [{kind = "top"}, {kind = "point", at = [0, 100], move = [5, 0]}] -> the point (0, 100) at different places
combination = [{name = "a", wind = 1.5}] -> wind: has no effect, as the scene has no [load.wind]
combination = [{name = "a"}, {name = "a"}] -> a: is the name of two combinations
combination = [{name = "a", bar = -1}] -> [combination] bar = -1: expected a number >= 0
combination = [{bar = 1}] -> [combination] name: is missing
load.wind = {direction = [0, 0, 1]} -> [load.wind] pressure: is missing; give it in N/m2, or speed in m/s
load.wind = {direction = [0, 0, 0], pressure = 1} -> direction = [0.0, 0.0, 0.0]: has no direction
load.wind = {direction = [0, 0, 1], pressure = 5, speed = 3} -> speed = 3: is not used together with pressure
load.wind = {speed = 6, direction = [1, 0]} -> [load.wind] speed: has no effect on a plane sheet along direction
support = {kind = "edge", edge = "top", held = "xy"}; load.point = {at = [0, 0], force = [0, 0, 1]} -> 1 N along z
support = {kind = "edge", edge = "top", held = "yz"}; load.wind = {pressure = 4, direction = [1, 0, 1]} -> along x
support = {kind = "edge", edge = "top", held = "xz"}; load.wind = {pressure = 6, direction = [0, 0, 1]} -> along y
obstacle = {kind = "cube"} -> [obstacle] kind = 'cube': is not one of floor, wall, sphere, cylinder, box
obstacle = {kind = "cylinder", axis = [0, 0, 0], radius = 1} -> axis = [0.0, 0.0, 0.0]: has no direction
obstacle = {kind = "box", corner = [0, 0, 0], size = [9, 4, 9], rounding = 3} -> half of its least length, 4 mm
obstacle = {kind = "floor", height = 120.0} -> floor: top is 20 mm inside it
obstacle = {kind = "sphere", centre = [50, 100, 0], radius = 30} -> sphere: top is 30 mm inside it
obstacle = {kind = "sphere", centre = [50, 40, 5], radius = 30} -> 24.4 mm inside it before anything moves
obstacle = {kind = "wall", facing = [1, 0, 2], point = [0, 0, 1]} -> wall: top is 0.8944 mm
obstacle = {kind = "sphere", centre = [54, 53, -30], radius = 4, move = [0, 0, 50]} -> less than a fifth of the sides
start = {origin = [0, 0, 0]} -> [start]: has no effect without bodies
material.poisson = 0.4 -> poisson = 0.4: is that of the law's table, 0.3
material.colour = 1 -> colour = 1: unknown key; known are material, density
material = {yield = 400.0, ultimate = 300.0} -> [material] ultimate = 300: is less than the yield stress, 400
curtain.width = 3.0 -> width = 3: is less than the mean diameter of a ring, 10 mm; lengths are in mm, did you mean 3000?
curtain = {shape = "disk", radius = 1.2} -> width = 2.4: is less than the mean diameter of a ring, 10 mm
support = {kind = "hooks", pitch = 0.2} -> (hooks) pitch = 0.2
obstacle = {kind = "sphere", centre = [0, 0, 50], radius = 0.05} -> less than the radius of a ring, 5 mm
support = [{kind = "top"}, {kind = "edge", edge = "bottom", move = [0, 2]}];
  obstacle = {kind = "sphere", centre = [50, 50, -31], radius = 30, move = [0, 0, 30]}
  -> [obstacle]: the curtain cannot clear its obstacles
start = {origin = [0, 0, 0], y_axis = [1, 1, 0]}; obstacle = {kind = "sphere", centre = [0, 0, 9], radius = 1}
  -> [start] y_axis = [1.0, 1.0, 0.0]: is not at a right angle to x_axis
support.kind = "rail"; obstacle = {kind = "wall", facing = [1, 1], point = [50, 10]} -> nothing carries the force of
load.wind = {pressure = 1000, direction = [1, 0, 0], follows = true} -> lies in the flat sheet
solver.bounds = true; obstacle = {kind = "sphere", centre = [50, 50, -60], radius = 20} -> adapt: do not go with sphere
solver.bounds = true; load.wind = {pressure = 5, direction = [0, 0, 1], follows = true} -> go with following pressure
motion.duration = 0.1; support = [] -> nothing holds
motion = {duration = 1.0, step = 2.0} -> longer than the duration
motion = {duration = 1e-300} -> expected a number >= 1e-09
motion.duration = 1.0; body = {kind = "sphere", radius = 50, mass = -1, at = [50, 50, 9]} -> mass = -1
motion.duration = 1.0; solver.space = true; body = {kind = "sphere", radius = 50, mass = 1, at = [50, 50, 9]} -> inside
motion.duration = 1.0; obstacle.kind = "floor"; body = {kind = "sphere", radius = 9, mass = 1, at = [0, 5, 99]} -> 4 mm
motion.duration = 1.0; body = {kind = "sphere", radius = 2, mass = 1, at = [0, 5, 99]} -> between which it would pass
motion.duration = 1.0; support = {kind = "top", history = [[1.0, 0.0], [0.5, 1.0]]} -> does not come after
motion.duration = 1.0; support = {kind = "top", history = [[0.0, nan]]} -> history
motion.duration = 1.0; support = {kind = "top", history = [[0.0, 0.0], [1.0, 1.0]]} -> without a move
motion.duration = 1.0; support = {kind = "track", fullness = 1.5, history = [[0, 1], [0.5, 0]]} -> share of 0, at 0.5 s
motion.duration = 1.0; load.wind = {speed = 9, direction = [0, 0, 1], history = [[0, -1]]} -> share of -1, at 0 s
motion.duration = 1.0; solver.bounds = true -> bounds and adapt: have no effect in motion
motion.duration = 1.0; mesh.element = "P2" -> motion needs P1
motion = {duration = 1.0, start = "reference"}; solver.tolerance = 1e-6 -> tolerance = 1e-06: has no effect in motion
motion = {duration = 1.0, step = 0.1, accuracy = 0.01} -> accuracy = 0.01: has no effect with step
curtain = [{shape = "disk", radius = 50}, {shape = "disk", radius = 90}] -> [curtain] is not one table
support = {kind = "top", release = 0.1} -> has no effect without [motion]
"""
"""Lines of a scene, and what is said of it; a line that begins with blanks goes on with the one before."""
ROWS = [line.rsplit(" -> ", 1) for line in REFUSED.strip().replace("\n  ", " ").splitlines()]


@pytest.mark.parametrize(("lines", "sentence"), ROWS, ids=[sentence for _, sentence in ROWS])
def test_what_a_scene_may_not_say_is_one_sentence(lines, sentence):
    tables, change = tomllib.loads(BASE), tomllib.loads(lines.replace("; ", "\n"))
    for key, value in change.items():
        joined = key in ("curtain", "mesh") and "shape" not in value and not isinstance(value, list)
        tables[key] = tables[key] | value if joined else value

    def answer():
        scene = read_scene(tables, "front.toml")
        return MovingCurtain(scene, default_law()).solve() if "motion" in tables else solve(scene, default_law())

    with pytest.raises(InputError) as error:
        answer()
    assert str(error.value).startswith("front.toml: ")
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)
