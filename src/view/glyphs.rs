//! Letters of three by five pixels, for labels of pictures.

/// Columns and rows of a letter.
const SIZE: (usize, usize) = (3, 5);

/// Letters as five rows of three bits each, an octal digit a row.
const GLYPHS: [(char, [u8; 5]); 50] = [
    ('0', [7, 5, 5, 5, 7]),
    ('1', [2, 6, 2, 2, 7]),
    ('2', [7, 1, 7, 4, 7]),
    ('3', [7, 1, 7, 1, 7]),
    ('4', [5, 5, 7, 1, 1]),
    ('5', [7, 4, 7, 1, 7]),
    ('6', [7, 4, 7, 5, 7]),
    ('7', [7, 1, 2, 2, 2]),
    ('8', [7, 5, 7, 5, 7]),
    ('9', [7, 5, 7, 1, 7]),
    ('A', [2, 5, 7, 5, 5]),
    ('B', [6, 5, 6, 5, 6]),
    ('C', [3, 4, 4, 4, 3]),
    ('D', [6, 5, 5, 5, 6]),
    ('E', [7, 4, 6, 4, 7]),
    ('F', [7, 4, 6, 4, 4]),
    ('G', [3, 4, 5, 5, 3]),
    ('H', [5, 5, 7, 5, 5]),
    ('I', [7, 2, 2, 2, 7]),
    ('J', [1, 1, 1, 5, 2]),
    ('K', [5, 5, 6, 5, 5]),
    ('L', [4, 4, 4, 4, 7]),
    ('M', [5, 7, 7, 5, 5]),
    ('N', [6, 5, 5, 5, 5]),
    ('O', [2, 5, 5, 5, 2]),
    ('P', [6, 5, 6, 4, 4]),
    ('Q', [2, 5, 5, 7, 3]),
    ('R', [6, 5, 6, 5, 5]),
    ('S', [3, 4, 2, 1, 6]),
    ('T', [7, 2, 2, 2, 2]),
    ('U', [5, 5, 5, 5, 7]),
    ('V', [5, 5, 5, 5, 2]),
    ('W', [5, 5, 7, 7, 5]),
    ('X', [5, 5, 2, 5, 5]),
    ('Y', [5, 5, 2, 2, 2]),
    ('Z', [7, 1, 2, 4, 7]),
    ('.', [0, 0, 0, 0, 2]),
    (',', [0, 0, 0, 2, 4]),
    ('-', [0, 0, 7, 0, 0]),
    ('+', [0, 2, 7, 2, 0]),
    ('_', [0, 0, 0, 0, 7]),
    (':', [0, 2, 0, 2, 0]),
    ('/', [1, 1, 2, 4, 4]),
    ('(', [1, 2, 2, 2, 1]),
    (')', [4, 2, 2, 2, 4]),
    ('=', [0, 7, 0, 7, 0]),
    ('%', [5, 1, 2, 4, 5]),
    ('^', [2, 5, 0, 0, 0]),
    ('*', [0, 5, 2, 5, 0]),
    ('?', [7, 1, 2, 0, 2]),
];

/// Pixels of `text` at `zoom` pixels a dot, as (x, y) from its upper left corner. Letters without a glyph are `?`.
pub(super) fn dots(text: &str, zoom: usize) -> impl Iterator<Item = (usize, usize)> {
    let letters: Vec<(usize, [u8; 5])> = text.chars().map(rows).enumerate().collect();
    letters.into_iter().flat_map(move |(index, rows)| {
        let left = index * (SIZE.0 + 1) * zoom;
        (0..SIZE.1 * zoom).flat_map(move |y| {
            let lit = move |x: &usize| rows[y / zoom] >> (SIZE.0 - 1 - x / zoom) & 1 == 1;
            (0..SIZE.0 * zoom).filter(lit).map(move |x| (left + x, y))
        })
    })
}

/// Pixels across that `text` takes.
pub(super) fn width(text: &str, zoom: usize) -> usize {
    (text.chars().count() * (SIZE.0 + 1)).saturating_sub(1) * zoom
}

/// Pixels down that a line takes.
pub(super) fn height(zoom: usize) -> usize {
    SIZE.1 * zoom
}

fn rows(letter: char) -> [u8; 5] {
    if letter == ' ' {
        return [0; 5];
    }
    let letter = letter.to_ascii_uppercase();
    let find = |wanted: char| GLYPHS.iter().find(|(glyph, _)| *glyph == wanted);
    find(letter)
        .or_else(|| find('?'))
        .map_or([0; 5], |(_, rows)| *rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_one_stands_upright() {
        let lit: Vec<_> = dots("1", 1).collect();
        assert_eq!(
            lit,
            [
                (1, 0),
                (0, 1),
                (1, 1),
                (1, 2),
                (1, 3),
                (0, 4),
                (1, 4),
                (2, 4)
            ]
        );
        assert_eq!((width("10", 2), height(2)), (14, 10));
    }
}
