//! Two unit squares face each other one unit apart; one emits, the other reflects `rho`. The form
//! factor between them is known in closed form, 0.199825 (Siegel and Howell, configuration C-11 with
//! both ratios 1), so the receiver's mean radiance must be `rho Le F`. Here nothing hides behind a
//! symmetry: cosines, solid angles, areas and pi must all be right.

mod common;

use common::{Baked, mean_radiance, parameters, scene};

/// Form factor of directly opposed parallel rectangles, sides `x` and `y` in units of their distance.
fn opposed(x: f64, y: f64) -> f64 {
    let (x2, y2) = (1.0 + x * x, 1.0 + y * y);
    let f = (x2 * y2 / (x2 + y * y)).sqrt().ln()
        + x * y2.sqrt() * (x / y2.sqrt()).atan()
        + y * x2.sqrt() * (y / x2.sqrt()).atan()
        - x * x.atan()
        - y * y.atan();
    2.0 * f / (std::f64::consts::PI * x * y)
}

#[test]
fn opposed_squares_exchange_what_their_form_factor_says() {
    let exact = opposed(1.0, 1.0);
    assert!((exact - 0.199825).abs() < 1e-6);
    let field = Baked::new(&scene("parallel_squares"), &parameters(2049, 128, 1)).open();
    let (rho, le) = (0.5, 1.0);
    let found = mean_radiance(&field, "receiver") / (rho * le);
    let off = found / exact - 1.0;
    assert!(off.abs() < 0.005, "form factor {found:.6}, not {exact:.6}: {:+.3} %", 100.0 * off);
}
