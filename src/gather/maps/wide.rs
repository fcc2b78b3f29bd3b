//! The looks of [`super::look`] for sixteen receivers at a time.

use super::crowd::{Block, LANES, Sums};
use super::look::{self, Rules, View};

/// Add what `blocks` see along all `views` to their `sums`, view after view.
pub(super) fn look(views: &[View], rules: &Rules, blocks: &[Block], sums: &mut [Sums]) {
    for view in views {
        for (block, sums) in blocks.iter().zip(sums.iter_mut()) {
            for lane in 0..LANES {
                look::look(view, rules, block, lane, sums);
            }
        }
    }
}
