//! Whether a frame sees a place.

use m4_core::CaptureFrame;

/// True where the camera of `frame` looks at or through the point: inside the image and not behind
/// the depth map. A frame without depth sees everything inside its image.
pub(crate) fn is_visible(frame: &CaptureFrame, p: [f32; 3], margin: f32) -> bool {
    let ([u, v], z) = frame.camera.project(&p.map(f64::from).into());
    let (w, h) = frame.rgb.size();
    let inside = z > 0.0 && u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5;
    if !inside {
        return false;
    }
    frame.depth.as_ref().is_none_or(|depth| {
        let (dw, dh) = depth.size();
        let x = ((u + 0.5) * dw as f64 / w as f64) as usize;
        let y = ((v + 0.5) * dh as f64 / h as f64) as usize;
        let surface = depth.at(x.min(dw - 1), y.min(dh - 1));
        // nothing known there: as likely seen as not
        !(surface > 0.0 && z as f32 > surface * (1.0 + margin))
    })
}
