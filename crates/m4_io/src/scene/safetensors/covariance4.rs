//! Dynamic splats as 4x4 covariances, the form in which other programs store 4D Gaussians.

use super::convert::{Arrays, Fault, Sources, f32_array};
use super::read::{fault_to_error, load};
use super::tensor::Source;
use super::write::save;
use super::{ReadSceneError, WriteSceneError};
use m4_core::{
    SplatLayout, Splats, StateTensor,
    covariance4::{Covariance4, VelocityForm},
    nalgebra::Matrix4,
};
use std::path::Path;

/// Largest difference of mirrored entries of a full matrix, relative to its trace, that is rounding.
const SYMMETRIC_WITHIN: f32 = 1e-4;

/// Writes the dynamic splats of a scene as a safetensors file with `mean [n, 4]` (x, y, z in world
/// units, t in frames), `covariance [n, 10]` (`xx, xy, xz, xt, yy, yz, yt, zz, zt, tt`), `opacity [n]`
/// (logit) and `colour [n, terms, 3]` (as in `splats.colour`). Static splats have no such form and are
/// left out.
///
/// # Errors
///
/// [`WriteSceneError`] when the file system refuses or a splat is not finite.
pub fn write_covariance4(path: &Path, splats: &Splats) -> Result<(), WriteSceneError> {
    let bad = |what: String| WriteSceneError::BadScene {
        path: path.to_path_buf(),
        what,
    };
    let n = splats.n_dynamic();
    let (mut mean, mut covariance, mut opacity, mut colour) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for i in 0..n {
        let form = VelocityForm::<f64>::from_splats(splats, i).map_err(|e| bad(e.to_string()))?;
        let form = form.to_covariance4();
        let numbers = form.mean.iter().chain(&form.covariance);
        if !numbers.clone().all(|v| v.is_finite()) {
            return Err(bad(format!("dynamic splat {i} is not finite")));
        }
        mean.extend(form.mean.map(|v| v as f32));
        covariance.extend(form.covariance.map(|v| v as f32));
        opacity.push(form.opacity as f32);
        colour.extend(form.colour.iter().flatten().map(|&v| v as f32));
    }
    let terms = splats.layout().colour_terms();
    let array = |shape: &[usize], data: Vec<f32>| {
        Source::Array(StateTensor::F32 {
            shape: shape.to_vec(),
            data: data.into(),
        })
    };
    let arrays = Sources::from([
        ("mean".to_owned(), array(&[n, 4], mean)),
        ("covariance".to_owned(), array(&[n, 10], covariance)),
        ("opacity".to_owned(), array(&[n], opacity)),
        ("colour".to_owned(), array(&[n, terms, 3], colour)),
    ]);
    save(path, &arrays, None)
}

/// Reads such a file as splats with `layout`, all of them dynamic. The covariance may also be the full
/// matrix, `[n, 4, 4]` in order x, y, z, t.
///
/// # Errors
///
/// [`ReadSceneError`] if the file is damaged, the number of colour terms is not that of `layout`, or a
/// covariance is not positive definite.
pub fn read_covariance4(path: &Path, layout: SplatLayout) -> Result<Splats, ReadSceneError> {
    let (_, arrays) = load(path)?;
    let fault = |fault| fault_to_error(path, fault);
    let n = arrays.get("opacity").map_or(0, StateTensor::len);
    let mean = f32_array(&arrays, "mean", &[n, 4]).map_err(fault)?.as_chunks::<4>().0;
    let opacity = f32_array(&arrays, "opacity", &[n]).map_err(fault)?;
    let terms = layout.colour_terms();
    let colour = f32_array(&arrays, "colour", &[n, terms, 3])
        .map_err(fault)?
        .as_chunks::<3>()
        .0;
    let covariance = packed(path, &arrays, n)?;
    let layout = SplatLayout {
        isotropic: false,
        ..layout
    };
    let mut splats = Splats::zeros(layout, 0, n);
    for i in 0..n {
        let bad = |name, value: String, expected: String| ReadSceneError::BadValue {
            path: path.to_path_buf(),
            splat: i,
            name,
            value,
            expected,
        };
        let colours = &colour[terms * i..terms * (i + 1)];
        let numbers = mean[i].iter().chain(colours.iter().flatten()).chain([&opacity[i]]);
        if let Some(value) = numbers.copied().find(|v| !v.is_finite()) {
            let expected = "finite numbers were expected".to_owned();
            return Err(bad("mean, opacity or colour", value.to_string(), expected));
        }
        let form = Covariance4::<f64> {
            mean: mean[i].map(f64::from),
            covariance: covariance[i].map(f64::from),
            opacity: f64::from(opacity[i]),
            colour: colours.iter().map(|c| c.map(f64::from)).collect(),
        };
        let form = form
            .to_velocity()
            .map_err(|e| bad("covariance", format!("{:?}", covariance[i]), e.to_string()))?;
        form.write(&mut splats, i).map_err(|e| {
            fault(Fault::Other {
                name: "colour".into(),
                found: e.to_string(),
                expected: format!("{terms} terms"),
            })
        })?;
    }
    Ok(splats)
}

/// Packed covariances from either form.
fn packed(path: &Path, arrays: &Arrays, n: usize) -> Result<Vec<[f32; 10]>, ReadSceneError> {
    let full = matches!(arrays.get("covariance"), Some(array) if array.shape() == [n, 4, 4]);
    if !full {
        let data = f32_array(arrays, "covariance", &[n, 10]).map_err(|f| fault_to_error(path, f))?;
        return Ok(data.as_chunks::<10>().0.to_vec());
    }
    let data = f32_array(arrays, "covariance", &[n, 4, 4]).map_err(|f| fault_to_error(path, f))?;
    let pack = |(splat, m): (usize, &[f32; 16])| {
        let m = Matrix4::from_row_slice(m);
        let off = (m - m.transpose()).amax();
        if off > SYMMETRIC_WITHIN * m.trace().abs() {
            return Err(ReadSceneError::BadValue {
                path: path.to_path_buf(),
                splat,
                name: "covariance",
                value: format!("a matrix whose mirrored entries differ by {off}"),
                expected: "a symmetric matrix was expected".into(),
            });
        }
        Ok(Covariance4::from_matrix([0.0; 4], &m, 0.0, Vec::new()).covariance)
    };
    data.as_chunks::<16>().0.iter().enumerate().map(pack).collect()
}
