//! AdamW: Adam with decoupled weight decay (Loshchilov & Hutter 2019), and the moving average of
//! the weights that it leads to (Polyak averaging).
//!
//! Every number of a [`Parameter`] is updated alone, so that one loop over flat slices does it all.

use ndarray::{Array, Dimension};

/// The step size.
const LEARNING_RATE: f32 = 0.03;
/// How much of a weight that decays goes in a step, as a share of the step size.
const WEIGHT_DECAY: f32 = 0.1;
/// How much of the running mean of gradients stays in a step.
const BETA_1: f64 = 0.9;
/// How much of the running mean of squared gradients stays in a step.
const BETA_2: f64 = 0.999;
/// Keeps the step of a weight finite whose gradient was always 0.
const EPSILON: f32 = 1e-8;
/// How much of the average of the weights stays in a step, at most.
const AVERAGE: f64 = 0.99;

/// An array of weights that learns.
pub struct Parameter<D: Dimension> {
    /// The weights as they are now.
    pub value: Array<f32, D>,
    /// The gradient of the loss by them, to be filled before each update.
    pub gradient: Array<f32, D>,
    /// The average of the weights over the latest steps: what is served, since single steps are
    /// noisy.
    pub average: Array<f32, D>,
    first_moment: Array<f32, D>,
    second_moment: Array<f32, D>,
    /// The share that decays in a step.
    decay: f32,
}

/// What is the same for every weight in one step: bias corrections, and the share of the average
/// that stays.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    first_correction: f32,
    second_correction: f32,
    stays: f32,
}

impl Step {
    /// Returns the step of this number, counted from 1.
    pub fn number(number: u32) -> Self {
        let number = f64::from(number);
        let correction = |beta: f64| (1.0 / (1.0 - beta.powf(number))) as f32;

        Self {
            first_correction: correction(BETA_1),
            second_correction: correction(BETA_2),
            // Quickly at first, for early weights are soon out of date.
            stays: AVERAGE.min(number / (number + 10.0)) as f32,
        }
    }
}

impl<D: Dimension> Parameter<D> {
    /// Makes weights that decay.
    pub fn decaying(value: Array<f32, D>) -> Self {
        Self::new(value, LEARNING_RATE * WEIGHT_DECAY)
    }

    /// Makes weights that do not decay, as is usual for biases.
    pub fn steady(value: Array<f32, D>) -> Self {
        Self::new(value, 0.0)
    }

    fn new(value: Array<f32, D>, decay: f32) -> Self {
        let zeros = || Array::zeros(value.raw_dim());

        Self {
            gradient: zeros(),
            first_moment: zeros(),
            second_moment: zeros(),
            average: value.clone(),
            value,
            decay,
        }
    }

    /// Takes one step along the gradient, and lets the average follow.
    pub fn update(&mut self, step: Step) {
        let values = slice(&mut self.value).iter_mut();
        let gradients = slice(&mut self.gradient).iter();
        let firsts = slice(&mut self.first_moment).iter_mut();
        let seconds = slice(&mut self.second_moment).iter_mut();
        let averages = slice(&mut self.average).iter_mut();
        let (beta_1, beta_2) = (BETA_1 as f32, BETA_2 as f32);
        let (stays, remains) = (step.stays, 1.0 - self.decay);

        for ((((value, gradient), first), second), average) in
            values.zip(gradients).zip(firsts).zip(seconds).zip(averages)
        {
            *first = beta_1 * *first + (1.0 - beta_1) * gradient;
            *second = beta_2 * *second + (1.0 - beta_2) * gradient * gradient;
            let direction = step.first_correction * *first
                / ((step.second_correction * *second).sqrt() + EPSILON);
            *value = remains * *value - LEARNING_RATE * direction;
            *average = stays * *average + (1.0 - stays) * *value;
        }
    }
}

fn slice<D: Dimension>(array: &mut Array<f32, D>) -> &mut [f32] {
    array
        .as_slice_mut()
        .expect("it is made in the standard layout, and nobody changes that")
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    /// Between 32 bits and 64, after some steps.
    const PRECISION: f64 = 1e-5;

    /// The formulas of the paper (algorithm 2), in 64 bits, for one weight: its value and average
    /// after these gradients.
    fn reference(mut value: f64, gradients: &[f64], decay: f64) -> [f64; 2] {
        let (mut first, mut second, mut average) = (0.0, 0.0, value);
        for (number, gradient) in (1..).zip(gradients) {
            first = 0.9 * first + 0.1 * gradient;
            second = 0.999 * second + 0.001 * gradient * gradient;
            let corrected = [
                first / (1.0 - 0.9_f64.powi(number)),
                second / (1.0 - 0.999_f64.powi(number)),
            ];
            value -= 0.03 * (corrected[0] / (corrected[1].sqrt() + 1e-8) + decay * value);
            let stays = (f64::from(number) / (f64::from(number) + 10.0)).min(0.99);
            average = stays * average + (1.0 - stays) * value;
        }
        [value, average]
    }

    #[test]
    fn steps_are_those_of_the_paper() {
        let gradients = [0.5, -0.25, 3.0, 0.0, 1e-4, -2.0];
        for (decay, mut parameter) in [
            (0.1, Parameter::decaying(array![0.7_f32, -1.5])),
            (0.0, Parameter::steady(array![0.7_f32, -1.5])),
        ] {
            for (number, gradient) in (1..).zip(gradients) {
                parameter.gradient = array![gradient as f32, -2.0 * gradient as f32];
                parameter.update(Step::number(number));
            }

            let doubled = gradients.map(|gradient| -2.0 * gradient);
            let expected = [
                reference(f64::from(0.7_f32), &gradients, decay),
                reference(-1.5, &doubled, decay),
            ];
            for (at, [value, average]) in expected.into_iter().enumerate() {
                let found = [parameter.value[at], parameter.average[at]].map(f64::from);
                assert!((found[0] - value).abs() < PRECISION, "{found:?} {value}");
                assert!(
                    (found[1] - average).abs() < PRECISION,
                    "{found:?} {average}"
                );
            }
        }
    }

    #[test]
    fn who_has_no_gradient_only_decays() {
        let mut parameter = Parameter::decaying(array![2.0_f32]);
        (1..=1_000).for_each(|number| parameter.update(Step::number(number)));
        let expected = 2.0 * 0.997_f64.powi(1_000);
        assert!((f64::from(parameter.value[0]) - expected).abs() < 1e-3);

        let mut bias = Parameter::steady(array![2.0_f32]);
        (1..=10).for_each(|number| bias.update(Step::number(number)));
        assert_eq!((bias.value[0], bias.average[0]), (2.0, 2.0));
    }

    #[test]
    fn a_gradient_that_is_no_number_spoils_the_weight_visibly() {
        let mut parameter = Parameter::steady(array![1.0_f32, 1.0]);
        parameter.gradient = array![f32::NAN, 0.5];
        parameter.update(Step::number(1));
        assert!(parameter.value[0].is_nan() && parameter.value[1].is_finite());
    }
}
