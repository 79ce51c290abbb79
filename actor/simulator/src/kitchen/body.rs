use crate::shape::Shape;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyRole {
    /// Never moves: walls, fixtures, and everything heavier than 10 kg.
    Static,
    Movable,
    Robot,
}

#[derive(Debug, Clone)]
pub struct Body {
    /// Unique within the kitchen, for example `Mug` or `Cabinet-3`.
    pub name: String,
    /// iTHOR's category name, or `Wall`, `Ceiling`, `Robot`.
    pub category: String,
    pub shape: Shape,
    pub role: BodyRole,
}

impl Body {
    /// A body that is called as its category.
    pub(super) fn of(category: &str, shape: Shape, role: BodyRole) -> Self {
        Self { name: category.to_owned(), category: category.to_owned(), shape, role }
    }
}

/// Numbers the bodies of a category that has several: `Cabinet-1`, `Cabinet-2`, ...
pub(super) fn number_names(bodies: &mut [Body]) {
    let names: Vec<String> = bodies.iter().map(|body| body.name.clone()).collect();
    for (index, body) in bodies.iter_mut().enumerate() {
        if names.iter().filter(|name| **name == names[index]).count() > 1 {
            let number = names[..=index].iter().filter(|name| **name == names[index]).count();
            body.name = format!("{}-{number}", names[index]);
        }
    }
}
