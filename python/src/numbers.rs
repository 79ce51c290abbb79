//! Numbers of Python and `NumPy`, written where they lie in a record.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use proto::task::{Dtype, Field};
use pyo3::prelude::*;
use pyo3::types::PyTypeMethods;

/// Writes what Python gives for a field: a number, or an array of the field's shape whose type is the field's own, or one
/// that is written as it: `float64` as 32 bits, other whole numbers as one that fits. The error says what it is instead.
pub fn write(value: &Bound<'_, PyAny>, shape: &[usize], field: Field, record: &mut [u8]) -> Result<(), String> {
    if shape.is_empty() {
        return scalar(value, field, record);
    }
    match field.dtype {
        Dtype::U8 => same::<u8>(value, shape, field, record).or_else(|wrong| {
            cast::<bool, u8>(value, shape, field, record, |number| Some(number.into()))
                // Of which Gymnasium makes MultiBinary and masks.
                .or_else(|_| cast::<i8, u8>(value, shape, field, record, |number| number.try_into().ok()))
                .map_err(|_| wrong)
        }),
        Dtype::U16 => same::<u16>(value, shape, field, record),
        Dtype::U32 => same::<u32>(value, shape, field, record),
        Dtype::U64 => same::<u64>(value, shape, field, record),
        Dtype::I32 => same::<i32>(value, shape, field, record)
            .or_else(|_| cast::<i8, i32>(value, shape, field, record, |number| Some(number.into())))
            .or_else(|_| cast::<i16, i32>(value, shape, field, record, |number| Some(number.into())))
            // Its error is the one that names a number that is too large.
            .or_else(|_| cast::<i64, i32>(value, shape, field, record, |number| number.try_into().ok())),
        Dtype::F32 => same::<f32>(value, shape, field, record)
            .or_else(|_| cast::<f64, f32>(value, shape, field, record, |number| Some(number as f32))),
        Dtype::F64 => same::<f64>(value, shape, field, record),
    }
}

fn scalar(value: &Bound<'_, PyAny>, field: Field, record: &mut [u8]) -> Result<(), String> {
    let place = &mut record[field.range()];
    let written = match field.dtype {
        Dtype::F32 => value.extract().ok().map(|number: f64| place.copy_from_slice(&(number as f32).to_ne_bytes())),
        Dtype::F64 => value.extract().ok().map(|number: f64| place.copy_from_slice(&number.to_ne_bytes())),
        dtype => whole(value).filter(|&number| dtype.write(number.cast_unsigned(), place)).map(|_| ()),
    };
    written.ok_or_else(|| format!("{}, not a number of type {}", kind(value), field.dtype))
}

/// A whole number, or a truth value as 0 or 1.
fn whole(value: &Bound<'_, PyAny>) -> Option<i64> {
    value.extract().ok().or_else(|| value.extract::<bool>().ok().map(i64::from))
}

fn same<T: Element + bytemuck::Pod>(
    value: &Bound<'_, PyAny>,
    shape: &[usize],
    field: Field,
    record: &mut [u8],
) -> Result<(), String> {
    let numbers = array::<T>(value, shape, field)?;
    let places = field.of_mut::<T>(record);
    match numbers.as_slice() {
        Ok(numbers) => places.copy_from_slice(numbers),
        Err(_) => places.iter_mut().zip(numbers.as_array().iter()).for_each(|(place, number)| *place = *number),
    }
    Ok(())
}

/// An array of a field's shape, and of this type.
fn array<'py, T: Element>(
    value: &Bound<'py, PyAny>,
    shape: &[usize],
    field: Field,
) -> Result<PyReadonlyArrayDyn<'py, T>, String> {
    let wrong = || format!("{}, not an array of {shape:?} {}", kind(value), field.dtype);
    let array = value.cast::<PyArrayDyn<T>>().map_err(|_| wrong())?;
    if array.shape() != shape {
        return Err(wrong());
    }
    array.try_readonly().map_err(|_| wrong())
}

fn cast<T: Element + Copy, U: bytemuck::Pod>(
    value: &Bound<'_, PyAny>,
    shape: &[usize],
    field: Field,
    record: &mut [u8],
    number: impl Fn(T) -> Option<U>,
) -> Result<(), String> {
    let numbers = array::<T>(value, shape, field)?;
    let places = field.of_mut::<U>(record);
    let mut fits = true;
    let mut put = |(place, from): (&mut U, &T)| match number(*from) {
        Some(number) => *place = number,
        None => fits = false,
    };
    match numbers.as_slice() {
        Ok(numbers) => places.iter_mut().zip(numbers).for_each(&mut put),
        Err(_) => places.iter_mut().zip(numbers.as_array().iter()).for_each(&mut put),
    }
    if fits { Ok(()) } else { Err(format!("{}, with a number beyond {}", kind(value), field.dtype)) }
}

/// What a value is, for people: an array with its shape and type, anything else by the name of its type.
pub fn kind(value: &Bound<'_, PyAny>) -> String {
    match value.cast::<numpy::PyUntypedArray>() {
        Ok(array) => format!("an array of {:?} {}", array.shape(), array.dtype()),
        Err(_) if value.is_none() => "None".to_owned(),
        Err(_) => value.get_type().name().map_or_else(|_| "something".to_owned(), |name| article(&name.to_string())),
    }
}

/// A type's name with its article: `an int`.
fn article(name: &str) -> String {
    let an = if name.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" };
    format!("{an} {name}")
}
