//! The one number that the motion of a part does not reveal.

use super::contact::Feet;
use super::hinge;
use super::shape::Shape;
use super::vote::Vote;
use super::{DistanceCue, OCCLUSION_RANGE, Tracklet, WorkingClip};
use crate::classical::dense::moving_depth::HIDDEN_QUANTILE;
use m4_core::quantile;

/// Share of the frames whose lower bound of the scale the scale exceeds, where nothing but bounds
/// is known.
const BOUND_QUANTILE: f64 = 0.75;
/// Least share of its frames in which a region must have ground under it for its scale to be known.
const STANDING_SHARE: f32 = 0.3;
/// Standard deviation of the logarithm of a scale by contact, where all frames agree: of outlines
/// and shapes.
const CONTACT_SIGMA: f64 = 0.06;
/// Differences between frames up to this standard deviation are no heights: feet touch the ground
/// one after the other, nearer and farther than the trunk.
const UNSTEADY: f64 = 0.1;
/// Probability that a part with ground under it stands there, and the range of logarithms over
/// which it may be anywhere else.
const STANDS: f64 = 0.85;
const ELSEWHERE: f64 = 1.6;
/// The same for a part that seems to turn about a fixed point.
const TURNS: f64 = 0.5;
const ANYWHERE: f64 = 3.7;
/// What falls in some frames stands in few of the others: it adds this to the standard deviation of
/// the logarithm of its scale by contact.
const LEAPS_SIGMA: f64 = 0.2;
/// Standard deviations by which a fall may be off the scale by a fixed point.
const HINGE_SIGMAS: f64 = 2.0;

/// What the frames of a part say about its scale: factors on its disparities.
pub(super) struct Reading {
    /// Its own disparity, before any factor: the median over frames.
    typical: f32,
    /// The least factor, by what the part hides and what lies under it.
    bound: f32,
    /// The factor by the ground that it stands on, or by the point about which it turns.
    pub decision: Option<Decision>,
}

/// What decides a scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Decision {
    pub vote: Vote,
    pub cue: DistanceCue,
}

impl Reading {
    /// What decides, given the scale by a fall: the surer of both, or both where they agree. A fall
    /// at another distance than that of a fixed point, or behind what the part hides, is a piece of
    /// a swing.
    pub fn decide_with(&self, fall: Option<Vote>) -> Option<Decision> {
        let Some(fall) = fall.filter(|fall| self.allows_fall(fall.factor as f32)) else {
            return self.decision;
        };
        let fall = Decision {
            vote: fall,
            cue: DistanceCue::Ballistic,
        };
        let Some(mut decision) = self.decision else {
            return Some(fall);
        };
        if decision.cue == DistanceCue::Contact {
            decision.vote.sigma = decision.vote.sigma.hypot(LEAPS_SIGMA);
        }
        let surer = match fall.vote.sigma < decision.vote.sigma {
            true => fall,
            false => decision,
        };
        let vote = fall.vote.agreed(decision.vote).unwrap_or(surer.vote);
        Some(Decision { vote, ..surer })
    }

    fn allows_fall(&self, factor: f32) -> bool {
        let hinged = self
            .decision
            .filter(|decision| decision.cue == DistanceCue::FixedPoint);
        let agrees = hinged.is_none_or(|Decision { vote, .. }| {
            (f64::from(factor) / vote.factor).ln().abs() < HINGE_SIGMAS * vote.sigma
        });
        agrees && factor > self.bound / OCCLUSION_RANGE
    }

    fn factor(&self) -> Option<f32> {
        self.decision.map(|decision| decision.vote.factor as f32)
    }
}

/// Reads the scale of one part.
///
/// In every frame the part is at least as near as what it hides: a lower bound of the factor, so a
/// high quantile of all frames is one, too. Where there is ground at its feet it touches that, but
/// for the errors of its outline and its shape: the median of those frames. All are in one unit.
pub(super) fn read(clip: &WorkingClip<'_>, tracklet: &Tracklet, shape: &Shape) -> Option<Reading> {
    let frames = tracklet.parts.len();
    let feet = Feet::of(clip, tracklet, &shape.blocks);
    let (mut all, mut standing, mut typical) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..frames {
        let Some(bound) = bound(clip, tracklet, shape, &feet, k) else {
            continue;
        };
        all.push(bound.factor);
        typical.push(bound.typical);
        standing.extend(bound.standing());
    }
    let share = standing.len() as f32 / frames as f32;
    let (bound, typical) = (
        quantile(&mut all, BOUND_QUANTILE)?,
        quantile(&mut typical, 0.5)?,
    );
    let contact = if share >= STANDING_SHARE {
        by_contact(&mut standing)
    } else {
        None
    };
    let hinge = fixed_point(clip, tracklet, shape)
        .filter(|vote| vote.factor > f64::from(bound / OCCLUSION_RANGE));
    Some(Reading {
        typical,
        bound,
        decision: decide(contact, hinge),
    })
}

/// The scale by a fixed point of the shape, or of the whole part: the shoulder of an arm that bends
/// stays in place, the elbow between its pieces does not.
fn fixed_point(clip: &WorkingClip<'_>, tracklet: &Tracklet, shape: &Shape) -> Option<Vote> {
    let whole = shape.whole.as_ref().and_then(|whole| {
        let mut vote = hinge::vote(clip, tracklet, &whole.shape)?;
        vote.factor /= f64::from(whole.ratio);
        Some(vote)
    });
    let own = hinge::vote(clip, tracklet, shape);
    (own.into_iter().chain(whole)).min_by(|a, b| a.sigma.total_cmp(&b.sigma))
}

/// The scale by the ground under a part. Where its frames differ by more than [`UNSTEADY`], it
/// hovers or leaps: every frame is then a lower bound, as far below the scale as it is above the
/// ground, and the scale is above their median by about the spread of what is left (exactly so for
/// heights with an exponential distribution, but for 3 %). That spread is drawn to nothing by the
/// share of the variance that is [`UNSTEADY`] (James and Stein 1961): frames hardly less steady
/// than feet say little of heights.
fn by_contact(standing: &mut [f32]) -> Option<Vote> {
    let vote = Vote::of_frames(standing, CONTACT_SIGMA)?;
    let variance = vote.sigma.powi(2) - CONTACT_SIGMA.powi(2);
    let height = match variance > UNSTEADY.powi(2) {
        true => variance.sqrt() * (1.0 - UNSTEADY.powi(2) / variance),
        false => 0.0,
    };
    Some(Vote {
        factor: vote.factor * height.exp(),
        ..vote
    })
}

/// The most probable scale. Either vote may be mistaken: what has ground under it may hover, which
/// puts it nearer, and what seems to turn may just move.
pub(super) fn decide(contact: Option<Vote>, hinge: Option<Vote>) -> Option<Decision> {
    let by = |cue| move |vote| Decision { vote, cue };
    let (Some(contact), Some(hinge)) = (contact, hinge) else {
        return contact
            .map(by(DistanceCue::Contact))
            .or(hinge.map(by(DistanceCue::FixedPoint)));
    };
    let density = |vote: Vote, log: f64| {
        let off = (log - vote.factor.ln()) / vote.sigma;
        (-0.5 * off * off).exp() / (vote.sigma * std::f64::consts::TAU.sqrt())
    };
    let likelihood = |candidate: &Decision| {
        let log = candidate.vote.factor.ln();
        let hovers = log > contact.factor.ln() - contact.sigma;
        let elsewhere = if hovers {
            (1.0 - STANDS) / ELSEWHERE
        } else {
            0.0
        };
        (STANDS * density(contact, log) + elsewhere)
            * (TURNS * density(hinge, log) + (1.0 - TURNS) / ANYWHERE)
    };
    let surer = if hinge.sigma < contact.sigma {
        DistanceCue::FixedPoint
    } else {
        DistanceCue::Contact
    };
    [
        Some(by(DistanceCue::Contact)(contact)),
        Some(by(DistanceCue::FixedPoint)(hinge)),
        contact.agreed(hinge).map(by(surer)),
    ]
    .into_iter()
    .flatten()
    .max_by(|a, b| likelihood(a).total_cmp(&likelihood(b)))
}

/// The factors of all parts. What neither stands nor turns about a fixed point, because it flies,
/// is taken to be about as near as what does: a guess, but a better one than the wall behind it.
pub(super) fn settle(readings: &[&Reading]) -> Vec<f32> {
    let mut near: Vec<f32> = readings
        .iter()
        .filter_map(|r| r.factor().map(|f| f * r.typical))
        .collect();
    let near = quantile(&mut near, 0.5);
    let guess = |r: &Reading| near.map_or(r.bound, |d| r.bound.max(d / r.typical));
    readings
        .iter()
        .map(|r| r.factor().unwrap_or_else(|| guess(r)))
        .collect()
}

/// What one frame says.
struct Bound {
    /// By what the part hides and what lies under it.
    factor: f32,
    /// By what lies under it alone.
    feet: f32,
    /// Median disparity of the part.
    typical: f32,
    /// Whether that is ground.
    on_ground: bool,
}

impl Bound {
    /// The factor by the ground under the part, if that is ground. What it seems to hide says
    /// nothing then: beside something static in front of the part, the background that is filled in
    /// behind it is as near as that.
    fn standing(&self) -> Option<f32> {
        (self.on_ground && self.feet > 0.0).then_some(self.feet)
    }
}

fn bound(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    shape: &Shape,
    feet: &Feet,
    k: usize,
) -> Option<Bound> {
    let background = &clip.disparity[tracklet.first + k];
    let (mut own, mut hidden): (Vec<f32>, Vec<f32>) = shape
        .values(clip, k)
        .map(|(p, d)| (d, background[p as usize] / d))
        .unzip();
    let on_ground = feet.on_ground(k);
    let feet = feet.factor(k, shape).unwrap_or(0.0);
    let hidden = quantile(&mut hidden, HIDDEN_QUANTILE).unwrap_or(0.0);
    let factor = feet.max(hidden);
    (factor > 0.0).then_some(Bound {
        factor,
        feet,
        on_ground,
        typical: quantile(&mut own, 0.5)?,
    })
}

#[cfg(test)]
mod tests {
    use super::{Decision, DistanceCue, Reading, Vote, by_contact, decide};

    #[test]
    fn the_surer_of_contact_and_hinge_decides_and_both_are_averaged_where_they_agree() {
        let vote = |factor: f64, sigma: f64| Some(Vote { factor, sigma });
        let decided = |contact: Option<Vote>, hinge: Option<Vote>| {
            let decision = decide(contact, hinge).unwrap();
            (decision.vote, decision.cue)
        };
        // A wheel on a pole: the ground behind it is no contact, and differs from frame to frame.
        let wheel = vote(1.1, 0.02);
        let expected = (wheel.unwrap(), DistanceCue::FixedPoint);
        assert_eq!(decided(vote(0.6, 0.13), wheel), expected);
        // A ball that rolls seems to turn about something.
        let ball = vote(1.0, 0.06);
        let expected = (ball.unwrap(), DistanceCue::Contact);
        assert_eq!(decided(ball, vote(2.0, 0.15)), expected);
        let (both, _) = decided(vote(1.0, 0.06), vote(1.08, 0.06));
        assert!((both.factor - 1.08f64.sqrt()).abs() < 1e-6, "{both:?}");
        assert!((both.sigma - 0.06 / 2f64.sqrt()).abs() < 1e-6, "{both:?}");
        assert_eq!(
            decided(None, wheel),
            (wheel.unwrap(), DistanceCue::FixedPoint)
        );
        assert_eq!(decide(None, None), None);
    }

    #[test]
    fn a_fall_is_in_front_of_what_the_part_hides_and_near_its_fixed_point() {
        let vote = |factor: f64, sigma: f64| Vote { factor, sigma };
        let reading = |cue: DistanceCue| Reading {
            typical: 1.0,
            bound: 0.6,
            decision: Some(Decision {
                vote: vote(1.0, 0.1),
                cue,
            }),
        };
        let cue = |reading: &Reading, factor: f64| {
            let decision = reading.decide_with(Some(vote(factor, 0.12)));
            decision.map(|decision| decision.cue)
        };
        let (fixed, contact, fall) = (
            Some(DistanceCue::FixedPoint),
            Some(DistanceCue::Contact),
            Some(DistanceCue::Ballistic),
        );
        let (hinge, stands) = (
            reading(DistanceCue::FixedPoint),
            reading(DistanceCue::Contact),
        );
        assert_eq!(cue(&hinge, 1.4), fixed);
        // What stands in some frames may fly in others, but not behind the wall.
        assert_eq!((cue(&stands, 1.4), cue(&stands, 0.4)), (fall, contact));
        let unknown = Reading {
            decision: None,
            ..stands
        };
        assert_eq!((cue(&unknown, 3.0), cue(&unknown, 0.4)), (fall, None));
        // Both count where they agree.
        let both = hinge.decide_with(Some(vote(1.1, 0.1))).unwrap().vote;
        assert!((both.factor - 1.1f64.sqrt()).abs() < 1e-6, "{both:?}");
    }

    #[test]
    fn what_hovers_is_nearer_than_most_of_the_ground_under_it() {
        // Heights with an exponential distribution over a true factor of 1.
        let leaps = |height: f64| {
            let mut factors: Vec<f32> = (0..200)
                .map(|k| (height * (1.0 - (k as f64 + 0.5) / 200.0).ln()).exp() as f32)
                .collect();
            by_contact(&mut factors).unwrap()
        };
        for height in [0.2, 0.4] {
            let vote = leaps(height);
            let off = vote.factor.ln().abs();
            assert!(
                off < 0.35 * height && off < vote.sigma,
                "{height}: {vote:?}"
            );
        }
        // Errors of outlines are no heights.
        let stands = leaps(0.05);
        assert!(
            (stands.factor.ln() + 0.05 * 2f64.ln()).abs() < 0.002,
            "{stands:?}"
        );
    }
}
