use super::message::tensor::Element;
use super::message::{Attribute, Dimension, Graph, Node, Shape, Tensor, TensorType, Type, Value, attribute};

const ROWS: &str = "rows";

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Name(String);

#[derive(Debug, Clone, Copy)]
pub(super) enum Parameter<'a> {
    Float(&'a str, f32),
    Int(&'a str, i64),
    Ints(&'a str, &'a [i64]),
}

impl Parameter<'_> {
    fn attribute(self) -> Attribute {
        let of = |name: &str, kind: attribute::Type| Attribute {
            name: name.to_owned(),
            r#type: kind.into(),
            ..Attribute::default()
        };
        match self {
            Self::Float(name, value) => Attribute { f: Some(value), ..of(name, attribute::Type::Float) },
            Self::Int(name, value) => Attribute { i: Some(value), ..of(name, attribute::Type::Int) },
            Self::Ints(name, values) => Attribute { ints: values.to_vec(), ..of(name, attribute::Type::Ints) },
        }
    }
}

pub(super) struct Builder {
    graph: Graph,
    /// What new results are part of; only for those who look at the graph.
    part: String,
}

impl Builder {
    pub fn new(name: &str) -> Self {
        Self { graph: Graph { name: name.to_owned(), ..Graph::default() }, part: String::new() }
    }

    pub fn part(&mut self, path: &str) {
        path.clone_into(&mut self.part);
    }

    /// An input \[rows, sizes...\].
    pub fn input(&mut self, name: &str, element: Element, sizes: &[i64], doc: &str) -> Name {
        self.graph.input.push(value(name, element, sizes, doc));
        Name(name.to_owned())
    }

    /// A result becomes the model's output \[rows, sizes...\], float32, under this name.
    pub fn output(&mut self, result: &Name, name: &str, sizes: &[i64], doc: &str) {
        self.graph.node.push(Node {
            input: vec![result.0.clone()],
            output: vec![name.to_owned()],
            name: format!("output.{name}"),
            op_type: "Identity".into(),
            attribute: vec![],
        });
        self.graph.output.push(value(name, Element::Float, sizes, doc));
    }

    pub fn floats(&mut self, name: &str, shape: &[i64], values: &[f32]) -> Name {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.initializer(name, Element::Float, shape, bytes)
    }

    pub fn float(&mut self, value: f32) -> Name {
        self.floats(&format!("float.{value}"), &[], &[value])
    }

    pub fn integers(&mut self, values: &[i64]) -> Name {
        let name = values.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.initializer(&format!("integers.{name}"), Element::Int64, &[values.len() as i64], bytes)
    }

    fn initializer(&mut self, name: &str, element: Element, shape: &[i64], raw_data: Vec<u8>) -> Name {
        // A name that is there already is the same number again.
        if !self.graph.initializer.iter().any(|there| there.name == name) {
            let tensor = Tensor { dims: shape.to_vec(), data_type: element.into(), name: name.to_owned(), raw_data };
            self.graph.initializer.push(tensor);
        }
        Name(name.to_owned())
    }

    pub fn apply(&mut self, operator: &str, inputs: &[&Name], parameters: &[Parameter]) -> Name {
        let output = format!("{}.{}.{operator}", self.part, self.graph.node.len());
        self.push(operator, inputs, parameters, vec![output.clone()]);
        Name(output)
    }

    /// An operator's results behind the first, which is not used: as many as have an ending of a name here.
    pub fn apply_rest(
        &mut self,
        operator: &str,
        inputs: &[&Name],
        parameters: &[Parameter],
        rest: &[&str],
    ) -> Vec<Name> {
        let output = format!("{}.{}.{operator}", self.part, self.graph.node.len());
        let outputs: Vec<String> = rest.iter().map(|ending| format!("{output}{ending}")).collect();
        self.push(operator, inputs, parameters, [&[String::new()], &outputs[..]].concat());
        outputs.into_iter().map(Name).collect()
    }

    fn push(&mut self, operator: &str, inputs: &[&Name], parameters: &[Parameter], output: Vec<String>) {
        self.graph.node.push(Node {
            input: inputs.iter().map(|input| input.0.clone()).collect(),
            name: output.last().cloned().unwrap_or_default(),
            output,
            op_type: operator.to_owned(),
            attribute: parameters.iter().map(|parameter| parameter.attribute()).collect(),
        });
    }

    /// What stands for an input that an operator does without.
    pub fn none() -> Name {
        Name(String::new())
    }

    pub fn finish(self) -> Graph {
        self.graph
    }
}

fn value(name: &str, element: Element, sizes: &[i64], doc: &str) -> Value {
    let rows = Dimension { dim_value: None, dim_param: Some(ROWS.to_owned()) };
    let sizes = sizes.iter().map(|&size| Dimension { dim_value: Some(size), dim_param: None });
    let shape = Shape { dim: std::iter::once(rows).chain(sizes).collect() };
    let tensor = TensorType { elem_type: element.into(), shape: Some(shape) };
    Value { name: name.to_owned(), r#type: Some(Type { tensor_type: Some(tensor) }), doc_string: doc.to_owned() }
}
