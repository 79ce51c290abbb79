//! What a solid looks like: its mesh, or the formula that it is drawn by.
//!
//! To make it takes long where it is a hull or round, and kitchens hold the same things over and over. So all sceneries
//! of a process that show equal solids share one model, for as long as any of them is there.

use super::round::Round;
use crate::mesh::{Edge, Mesh, Sphere, sides, sides_of_sphere};
use crate::shape::Primitive;
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex, OnceLock, Weak};
use xxhash_rust::xxh3::Xxh3;

#[derive(Debug)]
pub struct Model {
    /// Made when it is first asked for where the form is round: that is drawn from a mesh only next to the eye, and such
    /// a mesh is large.
    mesh: OnceLock<Mesh>,
    primitive: Primitive,
    /// None if the mesh is dented or not closed: its outline is not known then, and it is drawn face by face. None of
    /// what is round.
    pub edges: Option<Vec<Edge>>,
    pub bounds: Sphere,
    pub form: Form,
    pub triangles: usize,
}

#[derive(Debug, Clone, Copy)]
pub enum Form {
    Cuboid,
    Polyhedron,
    Cylinder(Round),
    Sphere(Round),
    /// A cylinder and a sphere at each of its ends.
    Capsule {
        mantle: Round,
        ends: Round,
    },
}

impl Model {
    fn of(primitive: &Primitive) -> Self {
        let mesh = Mesh::of(primitive);
        let form = match *primitive {
            Primitive::Cuboid { .. } => Form::Cuboid,
            Primitive::Hull { .. } | Primitive::Concave(_) => Form::Polyhedron,
            Primitive::Cylinder { radius_m, half_height_m } => {
                Form::Cylinder(Round::cylinder(radius_m, half_height_m, sides(radius_m)))
            }
            Primitive::Sphere { radius_m } => Form::Sphere(Round::sphere(radius_m, sides_of_sphere(radius_m))),
            Primitive::Capsule { radius_m, half_height_m } => {
                let sides = sides_of_sphere(radius_m);
                Form::Capsule {
                    mantle: Round::cylinder(radius_m, half_height_m, sides),
                    ends: Round::sphere(radius_m, sides),
                }
            }
        };
        // A box without thickness has fewer faces, and no table fits it.
        let form = if matches!(form, Form::Cuboid) && mesh.faces.len() != 6 { Form::Polyhedron } else { form };
        let (bounds, triangles, primitive) = (mesh.bounds(), mesh.triangle_count(), primitive.clone());
        if !matches!(form, Form::Cuboid | Form::Polyhedron) {
            return Self { mesh: OnceLock::new(), primitive, edges: None, bounds, form, triangles };
        }
        let edges = if matches!(primitive, Primitive::Concave(_)) { None } else { mesh.edges() };
        Self { mesh: OnceLock::from(mesh), primitive, edges, bounds, form, triangles }
    }

    /// The model of this solid that somebody has already, or a new one.
    fn shared(primitive: &Primitive, key: u64) -> Arc<Self> {
        // Nobody waits here for a thread of low priority: whoever finds the table in use makes a model of its own.
        let known = SHARED.try_lock().ok().and_then(|table| table.of.get(&key).and_then(Weak::upgrade));
        if let Some(known) = known.filter(|known| known.primitive == *primitive) {
            return known;
        }
        let model = Arc::new(Self::of(primitive));
        if let Ok(mut table) = SHARED.try_lock() {
            table.enter(key, &model);
        }
        model
    }

    pub fn mesh(&self) -> &Mesh {
        self.mesh.get_or_init(|| Mesh::of(&self.primitive))
    }
}

static SHARED: LazyLock<Mutex<Table>> = LazyLock::new(Mutex::default);

#[derive(Default)]
struct Table {
    of: HashMap<u64, Weak<Model>>,
    /// It is tidied when it has grown to this size.
    tidy_at: usize,
}

impl Table {
    /// Models that nobody has any more are forgotten from time to time, so that it stays as small as what is in use.
    fn enter(&mut self, key: u64, model: &Arc<Model>) {
        if self.of.len() >= self.tidy_at {
            self.of.retain(|_, model| model.strong_count() > 0);
            self.tidy_at = 2 * self.of.len() + 256;
        }
        self.of.insert(key, Arc::downgrade(model));
    }
}

/// The models of one scenery, each once.
#[derive(Default)]
pub struct Models {
    pub list: Vec<Arc<Model>>,
    numbers: HashMap<u64, usize>,
}

impl Models {
    /// Which of the list this solid is; it is added if it is not there.
    pub fn number_of(&mut self, primitive: &Primitive) -> usize {
        let key = key_of(primitive);
        if let Some(&known) = self.numbers.get(&key)
            && self.list[known].primitive == *primitive
        {
            return known;
        }
        self.list.push(Model::shared(primitive, key));
        self.numbers.insert(key, self.list.len() - 1);
        self.list.len() - 1
    }
}

/// Equal solids have equal keys, and others hardly ever. A zero with another sign makes another key, which costs a model
/// and nothing else.
fn key_of(primitive: &Primitive) -> u64 {
    let mut hash = Xxh3::new();
    add_to(&mut hash, primitive);
    hash.digest()
}

fn add_to(hash: &mut Xxh3, primitive: &Primitive) {
    let mut add = |kind: u8, numbers: &[f32]| {
        hash.update(&[kind]);
        for number in numbers {
            hash.update(&number.to_bits().to_le_bytes());
        }
    };
    match primitive {
        Primitive::Cuboid { half_extents_m } => add(0, &half_extents_m.to_array()),
        Primitive::Cylinder { radius_m, half_height_m } => add(1, &[*radius_m, *half_height_m]),
        Primitive::Capsule { radius_m, half_height_m } => add(2, &[*radius_m, *half_height_m]),
        Primitive::Sphere { radius_m } => add(3, &[*radius_m]),
        Primitive::Hull { points_m } => points_m.iter().for_each(|point| add(4, &point.to_array())),
        Primitive::Concave(concave) => {
            concave.vertices.iter().for_each(|vertex| add(5, &vertex.to_array()));
            concave.triangles.iter().flatten().for_each(|corner| hash.update(&corner.to_le_bytes()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::triangles_of;
    use crate::shape::Shape;
    use rapier3d::math::Vec3;

    fn solids() -> Vec<Primitive> {
        let corners = |height_m: f32| {
            [[0.0, 0.0, 0.0], [0.11, 0.0, 0.0], [0.0, height_m, 0.0], [0.0, 0.0, 0.13]].map(Vec3::from).to_vec()
        };
        vec![
            Primitive::Cuboid { half_extents_m: Vec3::new(0.117, 0.2, 0.3) },
            Primitive::Cuboid { half_extents_m: Vec3::new(0.117, 0.2, 0.31) },
            Primitive::Cylinder { radius_m: 0.117, half_height_m: 0.2 },
            Primitive::Capsule { radius_m: 0.117, half_height_m: 0.2 },
            Primitive::Sphere { radius_m: 0.117 },
            Primitive::Hull { points_m: corners(0.1) },
            Primitive::Hull { points_m: corners(0.12) },
        ]
    }

    #[test]
    fn equal_solids_have_one_model_in_all_sceneries_and_others_have_their_own() {
        for solid in &solids() {
            // Now and then another test has the table at that moment: then each has its own.
            let share = || {
                let [here, there] = [(); 2].map(|()| {
                    let mut models = Models::default();
                    assert_eq!([models.number_of(solid), models.number_of(&solid.clone())], [0; 2]);
                    models.list.remove(0)
                });
                Arc::ptr_eq(&here, &there)
            };
            assert!((0..1000).any(|_| share()), "{solid:?}");
        }
        let mut models = Models::default();
        for (index, solid) in solids().iter().enumerate() {
            assert_eq!(models.number_of(solid), index);
            assert_eq!(models.list[index].primitive, *solid);
            assert_eq!(models.list[index].triangles, triangles_of(&Shape::of(solid.clone())).len());
        }
    }

    #[test]
    fn models_that_nobody_has_are_forgotten() {
        let mut table = Table::default();
        let kept = Arc::new(Model::of(&Primitive::Sphere { radius_m: 0.1 }));
        table.enter(0, &kept);
        for key in 1..10_000 {
            table.enter(key, &Arc::new(Model::of(&solids()[0])));
            assert!(table.of.len() < 600, "{}", table.of.len());
        }
        assert!(Arc::ptr_eq(&table.of[&0].upgrade().unwrap(), &kept));
    }
}
