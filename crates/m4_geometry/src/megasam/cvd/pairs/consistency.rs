//! Which pixels of a flow field return to where they started.

use m4_core::Flow;

/// A flow field that a caller has, planes of `[height][width]`, pixels of its own size.
#[derive(Debug, Clone, Copy)]
pub struct FlowView<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// To the right.
    pub x: &'a [f32],
    /// Downwards.
    pub y: &'a [f32],
}

/// Greatest forward-backward error of a pixel that counts, pixels at the working size. MegaSaM: 1.
pub const MAX_ROUND_TRIP_PX: f32 = 1.0;

impl<'a> From<&'a Flow> for FlowView<'a> {
    fn from(flow: &'a Flow) -> Self {
        Self {
            width: flow.width,
            height: flow.height,
            x: &flow.u,
            y: &flow.v,
        }
    }
}

impl FlowView<'_> {
    /// The flow on an image of half the size (rounded down): bilinear at pixel centres, values scaled along.
    #[must_use]
    pub fn halved(&self) -> Flow {
        self.resized((self.width / 2).max(1), (self.height / 2).max(1))
    }

    /// The flow on an image of another size: bilinear at pixel centres, clamped at the edges, values scaled along.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Flow {
        let (sx, sy) = (self.width as f32 / width as f32, self.height as f32 / height as f32);
        let mut out = Flow {
            width,
            height,
            u: Vec::with_capacity(width * height),
            v: Vec::with_capacity(width * height),
        };
        for row in 0..height {
            let y = ((row as f32 + 0.5) * sy - 0.5).clamp(0.0, (self.height - 1) as f32);
            for column in 0..width {
                let x = ((column as f32 + 0.5) * sx - 0.5).clamp(0.0, (self.width - 1) as f32);
                out.u.push(sample(self.width, self.height, self.x, x, y) / sx);
                out.v.push(sample(self.width, self.height, self.y, x, y) / sy);
            }
        }
        out
    }
}

/// Bilinear value at `(x, y)` in pixel-centre coordinates; pixels outside are 0.
fn sample(width: usize, height: usize, plane: &[f32], x: f32, y: f32) -> f32 {
    // also where x or y is NaN
    if !(x > -1.0 && y > -1.0 && x < width as f32 && y < height as f32) {
        return 0.0;
    }
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let (x0, y0) = (x0 as isize, y0 as isize);
    let tap = |x: isize, y: isize| {
        let inside = x >= 0 && y >= 0 && x < width as isize && y < height as isize;
        if inside {
            plane[y as usize * width + x as usize]
        } else {
            0.0
        }
    };
    let top = tap(x0, y0) * (1.0 - fx) + tap(x0 + 1, y0) * fx;
    let bottom = tap(x0, y0 + 1) * (1.0 - fx) + tap(x0 + 1, y0 + 1) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// `[height][width]`: how far a pixel lands from where it started after going there and back, pixels; the way back is 0
/// outside the frame. A flow that is not finite gives infinity.
#[must_use]
pub fn round_trip_px(there: FlowView<'_>, back: FlowView<'_>) -> Vec<f32> {
    let (w, h) = (there.width, there.height);
    let mut out = Vec::with_capacity(w * h);
    for i in 0..w * h {
        let (u, v) = (there.x[i], there.y[i]);
        let (x, y) = ((i % w) as f32 + u, (i / w) as f32 + v);
        let error = (u + sample(back.width, back.height, back.x, x, y))
            .hypot(v + sample(back.width, back.height, back.y, x, y));
        out.push(if error.is_finite() { error } else { f32::INFINITY });
    }
    out
}

/// `[height][width]`: whether a pixel of `there` counts. It does if it returns to within [`MAX_ROUND_TRIP_PX`] and lands
/// inside the frame: a pixel that leaves meets a way back of 0, which a short way out would pass, and what is sampled
/// out there is no disparity.
#[must_use]
pub fn consistency_mask(there: FlowView<'_>, back: FlowView<'_>) -> Vec<bool> {
    let (w, h) = (there.width, there.height);
    let inside = |i: usize| {
        let (x, y) = ((i % w) as f32 + there.x[i], (i / w) as f32 + there.y[i]);
        x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32
    };
    let errors = round_trip_px(there, back).into_iter().enumerate();
    errors
        .map(|(i, error)| error < MAX_ROUND_TRIP_PX && inside(i))
        .collect()
}
