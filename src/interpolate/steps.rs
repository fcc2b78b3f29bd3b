//! What is done, one step after the other, until results are good enough.

use super::grow::{Field, Strictness};

use super::{Gathering, Kind, Work};
use crate::diagnostics::Cancelled;
use crate::gather::Engine;

/// What is done next with results that are not good enough.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    /// Gather at the seeds once more with those who saw first.
    Twice,
    /// Gather once more at those who speak for nobody, in as many other directions.
    AgainAlone,
    /// Cut cells until they are as smooth as this.
    Grow(Strictness),
    /// Gather at all whose values are not true.
    There,
    /// Gather once more at the seeds.
    Again,
    /// Gather at all.
    Everywhere,
}

impl Step {
    /// Of cells that it grows.
    pub(super) fn strictness(self) -> Option<Strictness> {
        match self {
            Self::Grow(strictness) => Some(strictness),
            Self::Twice => Some(Strictness::FIRST),
            _ => None,
        }
    }
}

/// In this order, and [`Step::Twice`] and [`Step::AgainAlone`] where results are refused first; values that were gathered are kept.
pub(super) const STEPS: [Step; 5] = [
    Step::Grow(Strictness::FIRST),
    Step::Grow(Strictness::SECOND),
    Step::There,
    Step::Again,
    Step::Everywhere,
];

/// What is wrong with results.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Fault {
    /// Blended values of these kinds, in order, are not true.
    Of(Vec<Kind>),
    /// None are.
    All,
    /// Nothing that is seen here, but they were not accepted.
    Refused,
}

impl Fault {
    pub(super) fn holds(&self, kind: Kind) -> bool {
        match self {
            Self::Of(kinds) => kinds.binary_search(&kind).is_ok(),
            Self::All | Self::Refused => true,
        }
    }
}

/// Who sees for seeds.
#[derive(Clone, Copy)]
pub(super) struct Sight<'a> {
    pub(super) engine: &'a dyn Engine,
    /// See [`Fewer::errors`]; 1 where all is seen.
    pub(super) errors: f64,
}

impl<'a> Sight<'a> {
    pub(super) fn full(gathering: Gathering<'a>) -> Self {
        Self {
            engine: gathering.engine,
            errors: 1.0,
        }
    }

    /// Of [`Gathering::fewer`], if there is somebody.
    pub(super) fn first(gathering: Gathering<'a>) -> Self {
        gathering.fewer.map_or(Self::full(gathering), |fewer| Self {
            engine: fewer.engine,
            errors: fewer.errors,
        })
    }

    pub(super) fn is_fewer(self) -> bool {
        self.errors > 1.0
    }
}

impl Work<'_> {
    /// The first seeds, for which fewer see if all is calm.
    pub(super) fn begin(&mut self) -> Result<Field, Cancelled> {
        let field = self.plant()?;
        if !self.sight.is_fewer() || self.is_calm(&field) {
            return Ok(field);
        }
        self.sight = Sight::full(self.gathering);
        self.plant()
    }

    /// What is done about a `fault` of `field` before anything else, if there is something.
    pub(super) fn soonest(&self, field: &Field, fault: &Fault) -> Option<Step> {
        match fault {
            Fault::Refused if self.sight.is_fewer() => Some(Step::Twice),
            Fault::Refused if field.alone.can_look_again() => Some(Step::AgainAlone),
            _ => None,
        }
    }

    /// Change `field`, which has this `fault`; false if there is nothing to do.
    pub(super) fn take(
        &mut self,
        step: Step,
        field: &mut Field,
        fault: &Fault,
    ) -> Result<bool, Cancelled> {
        match step {
            Step::Grow(strictness) => self.grow(field, strictness, fault)?,
            Step::Twice => {
                self.look_twice(field)?;
                self.grow(field, Strictness::FIRST, fault)?;
            }
            Step::AgainAlone => self.look_again_alone(&mut field.alone)?,
            Step::There if *fault == Fault::Refused => return Ok(false),
            Step::There => self.settle(field, fault)?,
            Step::Again => return self.look_again(field),
            Step::Everywhere => {
                field.forget_again();
                self.look_fully(field)?;
                let alone = field.alone.take();
                self.sow(&mut field.seeds, &alone)?;
                let all = Work {
                    gathering: Gathering {
                        thin: None,
                        ..self.gathering
                    },
                    ..*self
                };
                all.settle(field, &Fault::All)?;
            }
        }
        Ok(true)
    }

    /// Gather at all receivers of the cells of `field` that have this `fault`.
    fn settle(&self, field: &mut Field, fault: &Fault) -> Result<(), Cancelled> {
        let faulty = field.take_faulty(fault, &|i| self.gathering.kind(i as usize));
        let is_seed = field.seeds.marks(self.gathering.receivers.len());
        let rest: Vec<u32> = (faulty.iter())
            .flat_map(|cell| &field.cells.order[cell.run.clone()])
            .copied()
            .filter(|&i| !is_seed[i as usize])
            .collect();
        self.finish((&mut field.seeds, &mut field.alone), &rest)
    }

    /// Gather once more at all seeds of `field`, if somebody can, and as long as that is less than gathering everywhere.
    fn look_again(&self, field: &mut Field) -> Result<bool, Cancelled> {
        let seeds = &mut field.seeds;
        let is_less = 2 * seeds.len() < self.gathering.receivers.len();
        let Some(engine) = self.gathering.again.filter(|_| is_less) else {
            return Ok(false);
        };
        let read = self.read(engine, &seeds.receiver)?;
        let before = field.before.get_or_insert_default();
        before.extend_from_slice(&seeds.values[before.len()..]);
        seeds.take(&read, 0.5);
        Ok(true)
    }

    /// Gather at all seeds of `field`, for which fewer saw before, by other fewer ones: those to come see all that they may.
    fn look_twice(&mut self, field: &mut Field) -> Result<(), Cancelled> {
        self.sight = Sight::full(self.gathering);
        if let Some(fewer) = self.gathering.fewer {
            let read = self.read(fewer.again, &field.seeds.receiver)?;
            field.seeds.take(&read, 0.5);
            field.by_fewer = field.seeds.len();
        }
        Ok(())
    }

    /// Gather at all seeds of `field` for which fewer saw, as at all others.
    fn look_fully(&self, field: &mut Field) -> Result<(), Cancelled> {
        let by_fewer = std::mem::take(&mut field.by_fewer);
        let read = self.read(self.sight.engine, &field.seeds.receiver[..by_fewer])?;
        field.seeds.take(&read, 1.0);
        Ok(())
    }
}
