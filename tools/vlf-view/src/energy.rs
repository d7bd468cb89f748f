//! Where the light went, bounce by bounce, as lines of text.

use vlf::format::manifest::CycleLedger;

/// Bounces that are told.
const TOLD: usize = 8;

/// A line for each of the first bounces: what of the light of all lamps came in, was absorbed, left the
/// scene and went on.
pub fn lines(ledger: &[CycleLedger]) -> Vec<String> {
    let Some(emitted) = ledger.first().map(|c| c.emitted).filter(|e| *e > 0.0) else {
        return Vec::new();
    };
    let percent = |power: f64| format!("{:6.2}", 100.0 * power / emitted);
    let mut lines = vec!["bounce  in %   absorbed  left    goes on".to_owned()];
    lines.extend(ledger.iter().take(TOLD).map(|c| {
        let [came, absorbed, left, on] = [c.income(), c.absorbed, c.left, c.unshot()].map(percent);
        format!("{:5}  {came}   {absorbed}  {left}   {on}", c.cycle)
    }));
    if ledger.len() > TOLD {
        lines.push(format!("and {} more", ledger.len() - TOLD));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_of_what_the_lamps_emit() {
        let first = CycleLedger {
            emitted: 8.0,
            absorbed: 4.0,
            left: 2.0,
            unshot_diffuse: 2.0,
            ..CycleLedger::default()
        };
        let second =
            CycleLedger { cycle: 1, carried_in: 2.0, absorbed: 2.0, ..CycleLedger::default() };
        let lines = lines(&[first, second]);
        assert_eq!(lines[1], "    0  100.00    50.00   25.00    25.00");
        assert_eq!(lines[2], "    1   25.00    25.00    0.00     0.00");
        assert!(super::lines(&[]).is_empty());
    }
}
