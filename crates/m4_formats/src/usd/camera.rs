//! The source camera as a `UsdGeomCamera`.

use crate::rub::turn_pose;
use m4_scene::{Intrinsics, Scene, SourceFrame};
use std::io::{self, Write};

/// Width of the film, tenths of a scene unit, as USD counts it: that of a 35 mm camera.
const APERTURE: f64 = 36.0;
/// Far end of the view, world units.
const FAR: f64 = 1e6;

/// A value of the lens a frame.
type LensValue = fn(&Intrinsics) -> f64;

/// The attributes of the lens. A point at the left edge of the picture lies at `-cx / fx` times its depth,
/// and USD has it at `(-aperture / 2 + offset) / focal length`.
const LENS: [(&str, LensValue); 5] = [
    ("focalLength", |k| APERTURE * k.fx / k.width as f64),
    ("horizontalAperture", |_| APERTURE),
    ("verticalAperture", vertical_aperture),
    ("horizontalApertureOffset", |k| APERTURE * (0.5 - k.cx / k.width as f64)),
    ("verticalApertureOffset", |k| {
        vertical_aperture(k) * (k.cy / k.height as f64 - 0.5)
    }),
];

/// Pixels need not be square: the focal length is that of x.
fn vertical_aperture(k: &Intrinsics) -> f64 {
    APERTURE * k.fx / k.width as f64 * k.height as f64 / k.fy
}

/// Writes the prim; nothing when the scene has no cameras.
pub fn write(out: &mut impl Write, scene: &Scene) -> io::Result<()> {
    let Some(first) = scene.source.first() else {
        return Ok(());
    };
    writeln!(out, "\n    def Camera \"source_camera\"\n    {{")?;
    writeln!(out, "        float2 clippingRange = ({}, {FAR})", scene.near)?;
    writeln!(out, "        token projection = \"perspective\"")?;
    for (name, value) in LENS {
        let of = |frame: &SourceFrame| value(&frame.camera.intrinsics) as f32;
        if scene.source.iter().all(|f| of(f) == of(first)) {
            writeln!(out, "        float {name} = {}", of(first))?;
        } else {
            writeln!(out, "        float {name}.timeSamples = {{")?;
            for frame in &scene.source {
                writeln!(out, "            {}: {},", frame.t, of(frame))?;
            }
            writeln!(out, "        }}")?;
        }
    }
    writeln!(out, "        matrix4d xformOp:transform.timeSamples = {{")?;
    for frame in &scene.source {
        let pose = turn_pose(&frame.camera.c2w);
        write!(out, "            {}: (", frame.t)?;
        // USD multiplies rows from the left: columns of the rotation are rows, the place is the last
        for j in 0..3 {
            let [x, y, z] = std::array::from_fn(|i| pose.rotation[(i, j)] + 0.0);
            write!(out, "({x}, {y}, {z}, 0), ")?;
        }
        let t = pose.translation;
        writeln!(out, "({}, {}, {}, 1)),", t.x + 0.0, t.y + 0.0, t.z + 0.0)?;
    }
    writeln!(out, "        }}")?;
    writeln!(
        out,
        "        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}"
    )
}
