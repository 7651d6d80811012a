//! The definition, one splat at a time.

use m4_core::{
    Real,
    nalgebra::{Matrix3, Quaternion, Vector3, Vector4},
    quat,
};

/// A node that carries a splat, at an instant.
#[derive(Debug, Clone)]
pub struct Node<T: Real> {
    /// Where it is when it has not moved, world units.
    pub anchor: Vector3<T>,
    /// World units.
    pub position: Vector3<T>,
    /// `(w, x, y, z)`, of length 1.
    pub rotation: Vector4<T>,
    /// Its share of the motion.
    pub weight: T,
}

/// What a bound splat is stored as; also a gradient with respect to it.
#[derive(Debug, Clone)]
pub struct Splat<T: Real> {
    /// World units.
    pub mean: Vector3<T>,
    /// World units per frame.
    pub velocity: Vector3<T>,
    /// `(w, x, y, z)`, of any length.
    pub quat: Vector4<T>,
    /// Of the opacity.
    pub logit: T,
    /// Constant coefficients of the colour.
    pub rgb: Vector3<T>,
    /// Their change per frame.
    pub trend: Vector3<T>,
}

/// What is drawn of a splat; also a gradient with respect to it.
#[derive(Debug, Clone)]
pub struct Carried<T: Real> {
    /// World units.
    pub mean: Vector3<T>,
    /// Of any length.
    pub quat: Vector4<T>,
    /// Of the opacity.
    pub logit: T,
    /// Constant coefficients of the colour.
    pub rgb: Vector3<T>,
}

/// The gradient of a loss with respect to a splat and the nodes that carry it.
#[derive(Debug, Clone)]
pub struct Gradient<T: Real> {
    /// Of the splat.
    pub splat: Splat<T>,
    /// Of each node: with respect to its position, and to a turn about it (a rotation vector in
    /// world axes, applied last).
    pub nodes: Vec<[Vector3<T>; 2]>,
}

/// How much of a splat is there at `t`, 0..1: its life and half a fade, frames.
pub fn presence<T: Real>(t: T, [begin, end]: [T; 2], half: T) -> T {
    let step = |x: T| {
        let s = ((T::one() + x) / T::of(2.0)).clamp(T::zero(), T::one());
        s * s * (T::of(3.0) - T::of(2.0) * s)
    };
    step((t - begin) / half) * step((end - t) / half)
}

/// The splat at an instant `dt` frames after its `time_mean`, where it is there by `presence`,
/// above 0.
pub fn carry<T: Real>(nodes: &[Node<T>], splat: &Splat<T>, dt: T, presence: T) -> Carried<T> {
    let (a, b, q) = motion(nodes);
    Carried {
        mean: a * (splat.mean + splat.velocity * dt) + b,
        quat: product(&q, &splat.quat),
        logit: faded(splat.logit, presence).0,
        rgb: splat.rgb + splat.trend * dt,
    }
}

/// The gradient of a loss with respect to splat and nodes, given that with respect to what
/// [`carry`] gives.
pub fn backward<T: Real>(
    nodes: &[Node<T>],
    splat: &Splat<T>,
    dt: T,
    presence: T,
    g: &Carried<T>,
) -> Gradient<T> {
    let (a, _, q) = motion(nodes);
    let own = splat.mean + splat.velocity * dt;
    let g_own = a.transpose() * g.mean;
    let g_q = product(&g.quat, &conjugate(&splat.quat));
    let half = T::of(0.5);
    let of_node = |node: &Node<T>| {
        let arm = rotated(node, &(own - node.anchor));
        let turn = product(&g_q, &conjugate(&(node.rotation * side(nodes, node)))) * half;
        [
            g.mean * node.weight,
            (arm.cross(&g.mean) + Vector3::new(turn[1], turn[2], turn[3])) * node.weight,
        ]
    };
    Gradient {
        splat: Splat {
            mean: g_own,
            velocity: g_own * dt,
            quat: product(&conjugate(&q), &g.quat),
            logit: g.logit * faded(splat.logit, presence).1,
            rgb: g.rgb,
            trend: g.rgb * dt,
        },
        nodes: nodes.iter().map(of_node).collect(),
    }
}

/// `A`, `b` and `q`.
fn motion<T: Real>(nodes: &[Node<T>]) -> (Matrix3<T>, Vector3<T>, Vector4<T>) {
    let (mut a, mut b, mut q) = (Matrix3::zeros(), Vector3::zeros(), Vector4::zeros());
    for node in nodes {
        let r = quat::rotation(&node.rotation);
        a += r * node.weight;
        b += (node.position - r * node.anchor) * node.weight;
        q += node.rotation * (node.weight * side(nodes, node));
    }
    (a, b, q)
}

/// 1, or -1 where a quaternion lies opposite to that of the first node.
fn side<T: Real>(nodes: &[Node<T>], node: &Node<T>) -> T {
    if nodes[0].rotation.dot(&node.rotation) < T::zero() {
        -T::one()
    } else {
        T::one()
    }
}

fn rotated<T: Real>(node: &Node<T>, v: &Vector3<T>) -> Vector3<T> {
    quat::rotation(&node.rotation) * v
}

/// The logit of `1 - (1 - o)^f`, and its derivative with respect to the logit of `o`.
fn faded<T: Real>(logit: T, f: T) -> (T, T) {
    if f >= T::one() {
        return (logit, T::one());
    }
    let own = T::one() / (T::one() + (-logit).exp());
    // -f ln(1 - o) without loss: o near 0 or 1
    let depth = f * if logit > T::zero() {
        logit + (-logit).exp().ln_1p()
    } else {
        logit.exp().ln_1p()
    };
    let opacity = -(-depth).exp_m1();
    (opacity.ln() + depth, f * own / opacity)
}

fn product<T: Real>(a: &Vector4<T>, b: &Vector4<T>) -> Vector4<T> {
    let of = |v: &Vector4<T>| Quaternion::new(v[0], v[1], v[2], v[3]);
    let q = of(a) * of(b);
    Vector4::new(q.w, q.i, q.j, q.k)
}

fn conjugate<T: Real>(q: &Vector4<T>) -> Vector4<T> {
    Vector4::new(q[0], -q[1], -q[2], -q[3])
}

#[cfg(test)]
mod tests {
    use super::{Carried, Node, Splat, backward, carry, faded, presence};
    use m4_core::{
        CounterRng,
        nalgebra::{UnitQuaternion, Vector3, Vector4},
    };
    use m4_testkit::{assert_gradient, central_differences};

    const DT: f64 = 1.7;
    const PRESENCE: f64 = 0.3;

    fn unit(v: &Vector4<f64>) -> Vector4<f64> {
        v / v.norm()
    }

    fn splat(x: &[f64]) -> Splat<f64> {
        Splat {
            mean: Vector3::from_column_slice(&x[..3]),
            velocity: Vector3::from_column_slice(&x[3..6]),
            quat: Vector4::from_column_slice(&x[6..10]),
            logit: x[10],
            rgb: Vector3::from_column_slice(&x[11..14]),
            trend: Vector3::from_column_slice(&x[14..17]),
        }
    }

    /// The nodes after small motions: three numbers of the position and three of the turn for each.
    fn moved(nodes: &[Node<f64>], x: &[f64]) -> Vec<Node<f64>> {
        let one = |(node, x): (&Node<f64>, &[f64])| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&x[3..]));
            let r = node.rotation;
            let q = turn.quaternion() * m4_core::nalgebra::Quaternion::new(r[0], r[1], r[2], r[3]);
            Node {
                position: node.position + Vector3::from_column_slice(&x[..3]),
                rotation: Vector4::new(q.w, q.i, q.j, q.k),
                ..node.clone()
            }
        };
        nodes.iter().zip(x.chunks(6)).map(one).collect()
    }

    #[test]
    fn gradients_match_central_differences() {
        let mut rng = CounterRng::new(3, 0, 0);
        let mut draw = |n: usize| -> Vec<f64> { (0..n).map(|_| rng.normal()).collect() };
        let nodes: Vec<Node<f64>> = [0.4, 0.3, 0.2, 0.1]
            .iter()
            .enumerate()
            .map(|(k, &weight)| {
                let x = draw(10);
                // one of them on the other side
                let rotation =
                    Vector4::new(3.0, x[7], x[8], x[9]) * if k == 2 { -1.0 } else { 1.0 };
                Node {
                    anchor: Vector3::from_column_slice(&x[..3]),
                    position: Vector3::from_column_slice(&x[3..6]),
                    rotation: unit(&rotation),
                    weight,
                }
            })
            .collect();
        let (x, g) = (draw(17), draw(11));
        let g = Carried {
            mean: Vector3::from_column_slice(&g[..3]),
            quat: Vector4::from_column_slice(&g[3..7]),
            logit: g[7],
            rgb: Vector3::from_column_slice(&g[8..]),
        };
        let loss = |nodes: &[Node<f64>], x: &[f64]| {
            let c = carry(nodes, &splat(x), DT, PRESENCE);
            g.mean.dot(&c.mean) + g.quat.dot(&c.quat) + g.logit * c.logit + g.rgb.dot(&c.rgb)
        };
        let got = backward(&nodes, &splat(&x), DT, PRESENCE, &g);
        let s = &got.splat;
        let flat: Vec<f64> = [
            s.mean.as_slice(),
            s.velocity.as_slice(),
            s.quat.as_slice(),
            &[s.logit],
            s.rgb.as_slice(),
            s.trend.as_slice(),
        ]
        .concat();
        let want = central_differences(&x, 1e-6, |x| loss(&nodes, x));
        assert_gradient("splat", &flat, &want.gradient, 1e-7);
        let flat: Vec<f64> = got
            .nodes
            .iter()
            .flat_map(|[p, w]| [p.as_slice(), w.as_slice()].concat())
            .collect();
        let want = central_differences(&[0.0; 24], 1e-6, |d| loss(&moved(&nodes, d), &x));
        assert_gradient("nodes", &flat, &want.gradient, 1e-7);
    }

    #[test]
    fn a_splat_that_ends_where_another_begins_is_as_opaque_as_one() {
        for logit in [-3.0, 0.0, 4.0] {
            let opacity = |f: f64| 1.0 / (1.0 + (-faded(logit, f).0).exp());
            for k in 0..=20 {
                let t = 4.0 + 0.1 * f64::from(k);
                let f = [[f64::NEG_INFINITY, 5.0], [5.0, f64::INFINITY]]
                    .map(|life| presence(t, life, 0.6));
                let [a, b] = f.map(|f| if f > 0.0 { opacity(f) } else { 0.0 });
                assert!(
                    (a + b - a * b - opacity(1.0)).abs() < 1e-12,
                    "{a} and {b} at {t}"
                );
            }
        }
        assert_eq!(presence(5.0, [1.0, 9.0], 0.6), 1.0);
        assert_eq!(presence(0.3, [1.0, 9.0], 0.6), 0.0);
    }
}
