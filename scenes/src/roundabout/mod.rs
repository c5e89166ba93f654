//! A drive through a foggy roundabout at night.
//!
//! Right-hand traffic, four approaches a quarter turn apart, so that most of the street is one quarter under `-a 4 -rz 90`. Meters,
//! z up, asphalt at z = 0, kerb tops and verges at 0.12. Paint lies 5 mm above the painted surface, and objects on the ground reach
//! at least 5 cm into it, so that no two overlapping faces share a plane.
//!
//! Light: 40 lamps of 5000 lm, 8 m high, give about 20 lx on the carriageway and with 9 % reflectance 0.5 to 1 cd/m2. Fog: sigma_t
//! = 3.912 / 250 m (Koschmieder's law at 2 % contrast, \[koschmieder1924\]): a visibility of 250 m.

mod car;
mod drive;
mod house;
mod lamp;
mod plant;
mod sign;
mod street;

use crate::{SceneFile, ies};

const SCENE: &str = "\
# A foggy roundabout at night: 120 frames from the driver's seat, in by the south approach, round, out to the west.
# Written by `cargo run -p femc-scenes -- --write scenes`; every part is below roundabout/.
# z up, metres; lamps 5000 lm each; the carriageway's luminance is about 0.5 to 1 cd/m2 under them.

# The route, `drive`, first: a camera follows it.
i roundabout/drive.mgf

# The eye, in the car's frame: x forward, y left, z up, origin on the ground under the car's middle.
camera driver =
	origin -0.1 0.36 1.2
	target 9.9 0.2 1.25
	fov 42
	film 320 180
	along drive
camera overview =
	origin 25 -29 17
	target 1.5 -3 0
	fov 48
	film 320 180
# The car from a bystander on the corner of the south approach.
camera kerbside =
	origin 8.7 -20.8 1.65
	target 1.5 -13.5 1.1
	fov 48
	film 320 180

time 0 11.9 10

# Visibility 250 m: sigma_t = 3.912 / 250; droplets scatter forward and hardly absorb.
medium fog =
	c
	sigma_s 0.0153
	sigma_a 0.0003
	phase hg 0.7
mglobal fog

i roundabout/world.mgf
o lamps
i roundabout/lamps.mgf -a 4 -rz 90
o
";

const SCENE_IES: &str = "\
# The roundabout of roundabout.mgf with measured-style photometry: its 40 lamps are LM-63 road luminaires (5000 lm) instead of
# Lambertian panels, the fog is thinner and lies on the ground.
time 0 11.9 10
camera overview =
	origin 25 -29 17
	target 1.5 -3 0
	fov 48
	film 320 180
camera kerbside =
	origin 8.7 -20.8 1.65
	target 1.5 -13.5 1.1
	fov 48
	film 320 180
medium fog =
	c
	sigma_s 0.03
	sigma_a 0.0006
	phase schlick 0.6
	density height 2 6
mglobal fog
i roundabout/drive.mgf
i roundabout/world.mgf
o lamps
i roundabout/lamps-ies.mgf -a 4 -rz 90
o
";

const MATERIALS: &str = "\
# Materials of the roundabout. Reflectances are those of wet surfaces: dark, and asphalt with a dull shine.
m asphalt =
	sides 2
	c
	crgb 1 1 0.97
	rd 0.085
	c
	rs 0.06 0.3
m paint =
	sides 2
	c
	crgb 1 1 0.96
	rd 0.6
m kerbstone =
	sides 2
	c
	crgb 1 0.98 0.93
	rd 0.36
m paving =
	sides 2
	c
	crgb 1 0.9 0.8
	rd 0.2
m grass =
	sides 2
	c
	crgb 0.05 0.09 0.025
	rd 1
m leaf =
	sides 2
	c
	crgb 0.12 0.22 0.06
	rd 0.45
	td 0.4
m needle =
	sides 2
	c
	crgb 0.025 0.06 0.03
	rd 1
m bark =
	sides 2
	c
	crgb 0.11 0.08 0.06
	rd 1
m steel =
	sides 2
	c
	rd 0.25
	rs 0.15 0.3
m black =
	sides 2
	c
	rd 0.03
m white =
	sides 2
	c
	rd 0.75
m red =
	sides 2
	c
	crgb 0.6 0.03 0.03
	rd 1
m blue =
	sides 2
	c
	crgb 0.03 0.12 0.45
	rd 1
m wall =
	sides 2
	c
	crgb 0.55 0.47 0.38
	rd 0.8
m roof =
	sides 2
	c
	crgb 0.2 0.07 0.05
	rd 1
m lacquer =
	sides 2
	c
	crgb 0.065 0.18 0.27
	rd 0.9
	c
	rs 0.08 0.08
m darkglass =
	sides 2
	c
	rd 0.02
	rs 0.1 0
m rubber =
	sides 2
	c
	rd 0.035
m fabric =
	sides 2
	c
	crgb 0.05 0.045 0.04
	rd 1
# Emitters: one-sided, each a little before something black or solid. lm/m2.
m lamp =
	sides 1
	c
	cct 3000
	ed 45455
m window_warm =
	sides 1
	c
	cct 2700
	ed 240
m window_cool =
	sides 1
	c
	cct 4500
	ed 130
m headlight =
	sides 1
	c
	cct 4300
	ed 70000
	lobe 70
m taillight =
	sides 1
	c
	crgb 4.2 0.06 0.02
	ed 900
m indicator =
	sides 1
	c
	crgb 2.4 0.7 0.02
	ed 0
m hazard =
	sides 1
	c
	crgb 2.4 0.7 0.02
	ed 6000
";

const WORLD: &str = "\
# Everything but the lamps.
i materials.mgf
o street
i street.mgf
i quarter.mgf -a 4 -rz 90
o
o island
i island.mgf
o
o houses
i house.mgf -rz 45 -t 29.5 -30 0.12
i house.mgf -rz -42 -t -31 -27 0.12
i house.mgf -rz 141 -t 27 31 0.12
i house.mgf -rz 228 -t -30 33 0.12
i house.mgf -rz 91 -t 18.5 -61 0.12
o
o trees
i tree.mgf -t 9.2 -35 0.1
i tree.mgf -s 1.15 -rz 70 -t -9.6 -33 0.1
i tree.mgf -s 0.9 -rz 200 -t 21.5 -17 0.1
i tree.mgf -s 1.2 -rz 130 -t -18 -20.5 0.1
i tree.mgf -s 1.1 -rz 310 -t -47 -9.5 0.1
i tree.mgf -s 0.95 -rz 250 -t 19 20 0.1
i tree.mgf -s 1.25 -rz 160 -t 9.8 36 0.1
i tree.mgf -s 1.05 -rz 45 -t -9.4 39 0.1
i tree.mgf -s 0.9 -rz 100 -t -20 17.5 0.1
i conifer.mgf -s 1.3 -t 38 -18 0.1
i conifer.mgf -rz 10 -t 42 -22 0.1
i conifer.mgf -s 1.2 -rz 50 -t -39 -17 0.1
i conifer.mgf -s 1.5 -rz 90 -t -43 -22 0.1
i conifer.mgf -s 1.4 -rz 71 -t 15 44 0.1
i conifer.mgf -s 1.2 -rz 27 -t -16 48 0.1
i conifer.mgf -s 1.3 -rz 5 -t -44 20 0.1
i conifer.mgf -s 0.9 -rz 15 -t 12.5 -49 0.1
i conifer.mgf -s 1.1 -rz 81 -t -13 -47 0.1
o
# A parked car with its hazard lights on, half way up the pavement of the west approach.
o parked
xf -rz 180 -t -39 5.4 0.12
i car.mgf
i car-glass.mgf
i car-hazard.mgf
xf
o
# The driver's own car. Its windows are open, because the camera is inside.
o car
xf -path drive
i car.mgf
i car-lights.mgf
xf
o
";

/// Returns the files of the roundabout.
pub fn files() -> Vec<SceneFile> {
    let scene = format!("{SCENE}\n{}", drive::blinking_lights());
    [
        ("roundabout.mgf", scene),
        ("roundabout-ies.mgf", SCENE_IES.to_owned()),
        ("roundabout/materials.mgf", MATERIALS.to_owned()),
        ("roundabout/world.mgf", WORLD.to_owned()),
        ("roundabout/drive.mgf", drive::path()),
        ("roundabout/street.mgf", street::carriageway()),
        ("roundabout/quarter.mgf", street::quarter()),
        ("roundabout/island.mgf", street::island()),
        ("roundabout/lamp-body.mgf", lamp::body()),
        ("roundabout/lamp.mgf", lamp::panel_lamp()),
        ("roundabout/lamp-ies.mgf", lamp::measured_lamp()),
        ("roundabout/lamps.mgf", lamp::placements("lamp.mgf")),
        ("roundabout/lamps-ies.mgf", lamp::placements("lamp-ies.mgf")),
        ("roundabout/road.ies", ies::road()),
        ("roundabout/tree.mgf", plant::tree()),
        ("roundabout/conifer.mgf", plant::conifer()),
        ("roundabout/shrub.mgf", plant::shrub()),
        ("roundabout/house.mgf", house::house()),
        ("roundabout/window.mgf", house::window()),
        ("roundabout/car.mgf", car::body()),
        ("roundabout/car-glass.mgf", car::glass()),
        ("roundabout/car-lights.mgf", car::lights()),
        ("roundabout/car-hazard.mgf", car::hazard()),
    ]
    .into_iter()
    .map(|(path, text)| SceneFile::text(path, text))
    .collect()
}
